//! What the buffers of a device take.

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

impl Gpu {
    /// What the buffers of this device take, bytes. A buffer counts until its last handle is
    /// dropped; a recording that still binds it keeps the memory a little longer.
    pub fn memory(&self) -> MemoryUse {
        let (now, peak) = self.inner.tally.bytes();
        MemoryUse { now, peak }
    }

    /// Makes the peak what is in use now, so that the next thing can be measured by itself.
    pub fn forget_peak(&self) {
        self.inner.tally.forget_peak();
    }
}
