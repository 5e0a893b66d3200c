//! What workers are not asked for, for a while.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Workers, each with a kind of what it was asked and did not do, and since when that is.
#[derive(Debug, Default)]
pub struct Unwilling(Mutex<HashMap<String, Instant>>);

impl Unwilling {
    /// Notes one.
    pub fn note(&self, bell: &str) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.insert(bell.to_owned(), Instant::now());
    }

    /// Whether one was noted not longer ago; the others are forgotten.
    pub fn has(&self, bell: &str, within: Duration) -> bool {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|_, since| since.elapsed() < within);
        known.contains_key(bell)
    }
}
