//! The last checkpoint of a training.

use std::time::Instant;

/// The last checkpoint handed over.
pub(super) struct Kept {
    /// The step that it precedes.
    pub(super) step: u32,
    /// Its time.
    pub(super) at: Instant,
}

impl Kept {
    /// A checkpoint made now, or the start of training.
    pub(super) fn now(step: u32) -> Self {
        let at = Instant::now();
        Self { step, at }
    }
}
