//! Memory use of a device's buffers.

use crate::Gpu;

/// Bytes in buffers created by fled-gpu: storage and read-backs. Excludes additional memory of the
/// driver (pipelines, staging of writes, padding) and the timestamps of a profiled submission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes in live buffers.
    pub now: u64,
    /// Peak since the device was opened or [`Gpu::forget_peak`] was called.
    pub peak: u64,
}

impl Gpu {
    /// Memory use of this device's buffers. A buffer counts until its last handle is dropped; a
    /// recording that still binds it keeps the memory slightly longer.
    pub fn memory(&self) -> MemoryUse {
        let (now, peak) = self.inner.tally.bytes();
        MemoryUse { now, peak }
    }

    /// Resets the peak to the current use, to start a new measurement.
    pub fn forget_peak(&self) {
        self.inner.tally.forget_peak();
    }
}
