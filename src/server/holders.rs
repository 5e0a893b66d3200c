//! Who has an upload in pieces: one at a time.
//!
//! A client that has lost its connection comes back on another before the server knows of the
//! loss. So who comes later takes over: who has the upload is told to stop, and has let go, with
//! all that it wrote on the disk, before the later one is told how much there is.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use tokio_util::sync::CancellationToken;

/// Those who have an upload.
#[derive(Clone, Debug, Default)]
pub struct Holders(Arc<Mutex<HashMap<String, Holder>>>);

#[derive(Clone, Debug)]
struct Holder {
    stop: CancellationToken,
    gone: CancellationToken,
}

/// An upload that nobody else has, until this is dropped.
#[derive(Debug)]
pub struct Hold {
    id: String,
    holder: Holder,
    holders: Holders,
}

impl Holders {
    /// Takes an upload over from whoever has it; `None` when they have not let go within
    /// `patience`.
    pub async fn take(&self, id: &str, patience: Duration) -> Option<Hold> {
        let end = Instant::now() + patience;
        loop {
            let gone = match self.try_take(id) {
                Ok(hold) => return Some(hold),
                Err(holder) => holder.gone,
            };
            timeout_at(end, gone.cancelled()).await.ok()?;
        }
    }

    /// The upload, or who has it and was told to stop.
    fn try_take(&self, id: &str) -> Result<Hold, Holder> {
        let mut held = self.lock();
        if let Some(holder) = held.get(id) {
            holder.stop.cancel();
            return Err(holder.clone());
        }
        let holder = Holder {
            stop: CancellationToken::new(),
            gone: CancellationToken::new(),
        };
        held.insert(id.to_owned(), holder.clone());
        Ok(Hold {
            id: id.to_owned(),
            holder,
            holders: self.clone(),
        })
    }

    /// Whether somebody has it.
    pub fn has(&self, id: &str) -> bool {
        self.lock().contains_key(id)
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, Holder>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Hold {
    /// Returns when somebody else wants it: then it is to be dropped soon.
    pub async fn wanted(&self) {
        self.holder.stop.cancelled().await;
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        self.holders.lock().remove(&self.id);
        self.holder.gone.cancel();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn who_comes_later_takes_over_when_the_first_has_let_go() {
        let holders = Holders::default();
        let short = Duration::from_millis(20);
        let first = holders.take("a", short).await.expect("free");
        assert!(holders.take("b", short).await.is_some(), "another upload");
        assert!(holders.take("a", short).await.is_none(), "still held");
        tokio::time::timeout(short, first.wanted())
            .await
            .expect("it is told to stop");
        let long = Duration::from_secs(20);
        let others = holders.clone();
        let second = tokio::spawn(async move { others.take("a", long).await });
        tokio::time::sleep(short).await;
        assert!(!second.is_finished(), "the first has not let go");
        drop(first);
        let second = second.await.expect("no panic").expect("taken over");
        assert!(holders.has("a"));
        let unwanted = tokio::time::timeout(short, second.wanted()).await;
        assert!(unwanted.is_err(), "nobody wants it");
        drop(second);
        assert!(!holders.has("a"));
    }
}
