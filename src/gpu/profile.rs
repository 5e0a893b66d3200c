//! Times of kernels, summed by kernel.

use std::collections::BTreeMap;
use std::time::Duration;

/// Sums by kernel.
pub(crate) type Profile = BTreeMap<&'static str, KernelTime>;

/// Times of one kernel since profiling began.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KernelTime {
    /// Number of dispatches.
    pub dispatches: u64,
    /// Total time on the device.
    pub total: Duration,
    /// The shortest dispatch.
    pub shortest: Duration,
}
