//! Workers that are not asked for a while.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Workers that did not do what they were asked, and since when they are not asked.
#[derive(Debug, Default)]
pub struct Unwilling(Mutex<HashMap<String, Instant>>);

impl Unwilling {
    /// Notes one.
    pub fn note(&self, worker: &str) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert(worker.to_owned(), Instant::now());
    }

    /// Whether one was noted not longer ago; the others are forgotten.
    pub fn has(&self, worker: &str, within: Duration) -> bool {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|_, since| since.elapsed() < within);
        known.contains_key(worker)
    }
}
