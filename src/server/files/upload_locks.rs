//! Locks on resumable uploads: one request at a time uses an upload.
//!
//! A client that has lost its connection returns on another before the server notices the loss. So
//! the later request takes over: the earlier one stops, and its bytes are on disk before the later
//! one counts them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// The uploads that are in use.
#[derive(Clone, Debug, Default)]
pub struct UploadLocks(Arc<Mutex<HashMap<String, State>>>);

#[derive(Clone, Debug)]
struct State {
    wanted: CancellationToken,
    released: CancellationToken,
}

/// Exclusive use of an upload until dropped.
#[derive(Debug)]
pub struct UploadLock {
    id: String,
    state: State,
    locks: UploadLocks,
}

impl UploadLocks {
    /// Takes an upload over from the request that uses it; `None` if that request does not release
    /// it within `patience`.
    pub async fn take(&self, id: &str, patience: Duration) -> Option<UploadLock> {
        let end = Instant::now() + patience;
        loop {
            let released = match self.try_take(id) {
                Ok(lock) => return Some(lock),
                Err(state) => state.released,
            };
            timeout_at(end, released.cancelled()).await.ok()?;
        }
    }

    /// The lock, or the state of the lock that another request holds and was asked to release.
    fn try_take(&self, id: &str) -> Result<UploadLock, State> {
        let mut locks = self.lock();
        if let Some(state) = locks.get(id) {
            state.wanted.cancel();
            return Err(state.clone());
        }
        let state = State { wanted: CancellationToken::new(), released: CancellationToken::new() };
        locks.insert(id.to_owned(), state.clone());
        Ok(UploadLock { id: id.to_owned(), state, locks: self.clone() })
    }

    /// Whether a request uses the upload.
    pub fn contains(&self, id: &str) -> bool {
        self.lock().contains_key(id)
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, State>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl UploadLock {
    /// Returns once another request wants the upload: drop the lock soon after.
    pub async fn wanted(&self) {
        self.state.wanted.cancelled().await;
    }
}

impl Drop for UploadLock {
    fn drop(&mut self) {
        self.locks.lock().remove(&self.id);
        self.state.released.cancel();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_later_request_takes_an_upload_over_once_the_first_releases_it() {
        let locks = UploadLocks::default();
        let short = Duration::from_millis(20);
        let first = locks.take("a", short).await.expect("free");
        assert!(locks.take("b", short).await.is_some(), "another upload");
        assert!(locks.take("a", short).await.is_none(), "still in use");
        tokio::time::timeout(short, first.wanted()).await.expect("the later request wants it");
        let long = Duration::from_secs(20);
        let others = locks.clone();
        let second = tokio::spawn(async move { others.take("a", long).await });
        tokio::time::sleep(short).await;
        assert!(!second.is_finished(), "the first has not released it");
        drop(first);
        let second = second.await.expect("no panic").expect("taken over");
        assert!(locks.contains("a"));
        let unwanted = tokio::time::timeout(short, second.wanted()).await;
        assert!(unwanted.is_err(), "no other request wants it");
        drop(second);
        assert!(!locks.contains("a"));
    }
}
