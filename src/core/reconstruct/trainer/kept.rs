//! What of a training is kept.

use std::time::Instant;

/// The last checkpoint that somebody has.
pub(super) struct Kept {
    /// The step before which it was made.
    pub(super) step: u32,
    /// When.
    pub(super) at: Instant,
}

impl Kept {
    /// One that was made now; where a training begins, what it begins with.
    pub(super) fn now(step: u32) -> Self {
        let at = Instant::now();
        Self { step, at }
    }
}
