//! What kernels took, summed by kernel.

use std::collections::BTreeMap;
use std::time::Duration;

/// Sums by kernel.
pub(crate) type Profile = BTreeMap<&'static str, KernelTime>;

/// What one kernel took since profiling began.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KernelTime {
    /// Dispatches.
    pub dispatches: u64,
    /// Time on the device.
    pub total: Duration,
    /// The shortest dispatch.
    pub shortest: Duration,
}
