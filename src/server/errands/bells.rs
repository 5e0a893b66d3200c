//! Bells by name: who waits for something holds one, who has done it rings it.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::Notify;

/// The bells that somebody here holds.
#[derive(Debug, Default)]
pub struct Bells(Mutex<HashMap<String, Weak<Notify>>>);

impl Bells {
    /// The bell of this name: all who ask for it hold the same.
    pub fn of(&self, name: &str) -> Arc<Notify> {
        let mut bells = self.lock();
        if let Some(bell) = bells.get(name).and_then(Weak::upgrade) {
            return bell;
        }
        bells.retain(|_, bell| bell.strong_count() > 0);
        let bell = Arc::new(Notify::new());
        bells.insert(name.to_owned(), Arc::downgrade(&bell));
        bell
    }

    /// Wakes one who waits for it; or who waits next, as long as somebody holds it.
    pub fn ring(&self, name: &str) {
        if let Some(bell) = self.lock().get(name).and_then(Weak::upgrade) {
            bell.notify_one();
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<String, Weak<Notify>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_bell_that_was_rung_before_anybody_waited_is_heard() {
        let bells = Bells::default();
        let (mine, other) = (bells.of("a"), bells.of("b"));
        bells.ring("a");
        bells.ring("nobody's");
        mine.notified().await;
        let soon = std::time::Duration::from_millis(10);
        let heard = tokio::time::timeout(soon, other.notified()).await;
        assert!(heard.is_err(), "another's bell");
        drop(mine);
        drop(bells.of("c"));
        assert_eq!(bells.lock().len(), 2, "nobody holds `a`");
    }
}
