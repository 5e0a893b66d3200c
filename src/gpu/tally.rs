//! The count of the bytes in buffers.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The count of one device.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    now: AtomicU64,
    peak: AtomicU64,
}

/// Bytes that are counted during its lifetime.
#[derive(Debug)]
pub(crate) struct Reservation {
    tally: Arc<Tally>,
    bytes: u64,
}

impl Tally {
    pub(crate) fn reserve(self: &Arc<Self>, bytes: u64) -> Reservation {
        let now = self.now.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(now, Ordering::Relaxed);
        Reservation { tally: self.clone(), bytes }
    }

    /// Bytes in use, and the peak.
    pub(crate) fn bytes(&self) -> (u64, u64) {
        let read = |value: &AtomicU64| value.load(Ordering::Relaxed);
        (read(&self.now), read(&self.peak))
    }

    pub(crate) fn forget_peak(&self) {
        let (now, _) = self.bytes();
        self.peak.store(now, Ordering::Relaxed);
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.tally.now.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reservation_counts_while_it_lives() {
        let tally = Arc::new(Tally::default());
        let first = tally.reserve(100);
        drop(tally.reserve(50));
        assert_eq!(tally.bytes(), (100, 150));
        drop(first);
        assert_eq!(tally.bytes(), (0, 150));
    }
}
