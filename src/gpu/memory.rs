//! What the buffers of a device take.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::Gpu;

/// Bytes in buffers that fled-gpu made: storage and read-backs. What the driver takes beside them
/// (pipelines, staging of writes, padding) is not seen from here, nor are the timestamps of a
/// profiled submission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes in buffers that live.
    pub now: u64,
    /// The most since the device was opened or [`Gpu::forget_peak`].
    pub peak: u64,
}

/// The count of one device.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    now: AtomicU64,
    peak: AtomicU64,
}

/// Bytes that are counted as long as this lives.
#[derive(Debug)]
pub(crate) struct Reservation {
    tally: Arc<Tally>,
    bytes: u64,
}

impl Tally {
    pub(crate) fn reserve(self: &Arc<Self>, bytes: u64) -> Reservation {
        let now = self.now.fetch_add(bytes, Ordering::Relaxed) + bytes;
        self.peak.fetch_max(now, Ordering::Relaxed);
        Reservation {
            tally: self.clone(),
            bytes,
        }
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.tally.now.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl Gpu {
    /// What the buffers of this device take, bytes. A buffer counts until its last handle is
    /// dropped; a recording that still binds it keeps the memory a little longer.
    pub fn memory(&self) -> MemoryUse {
        let read = |value: &AtomicU64| value.load(Ordering::Relaxed);
        MemoryUse {
            now: read(&self.inner.tally.now),
            peak: read(&self.inner.tally.peak),
        }
    }

    /// Makes the peak what is in use now, so that the next thing can be measured by itself.
    pub fn forget_peak(&self) {
        self.inner
            .tally
            .peak
            .store(self.memory().now, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reservation_counts_while_it_lives_and_the_peak_stays() {
        let tally = Arc::new(Tally::default());
        let first = tally.reserve(100);
        drop(tally.reserve(50));
        assert_eq!(
            (
                tally.now.load(Ordering::Relaxed),
                tally.peak.load(Ordering::Relaxed)
            ),
            (100, 150)
        );
        drop(first);
        assert_eq!(
            (
                tally.now.load(Ordering::Relaxed),
                tally.peak.load(Ordering::Relaxed)
            ),
            (0, 150)
        );
    }
}
