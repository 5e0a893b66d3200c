//! The options of a benchmark.

use serde::Serialize;

/// Maximum number of steps in a case, so that warm-up and both halves of a case are within the
/// round.
pub const MOST_STEPS: u32 = 2_000;

/// The length of each half of a case, without and with timestamps. The first limit reached ends it,
/// after at least three steps, or after one step if that exceeds the seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Budget {
    /// Seconds.
    pub seconds: f64,
    /// Steps.
    pub steps: u32,
}

/// The options of a benchmark.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchOptions {
    /// Widths and heights of the images, px.
    pub sizes: Vec<(usize, usize)>,
    /// Numbers of Gaussians, and of sorted keys.
    pub gaussians: Vec<usize>,
    /// The length of a case.
    pub budget: Budget,
    /// Seed of the synthetic scenes.
    pub seed: u64,
}

impl Default for BenchOptions {
    /// The sizes and numbers of the presets.
    fn default() -> Self {
        Self {
            sizes: vec![(280, 160), (560, 320), (1120, 640)],
            gaussians: vec![10_000, 50_000, 200_000],
            budget: Budget { seconds: 5.0, steps: 100 },
            seed: 0,
        }
    }
}

impl BenchOptions {
    /// One small size and a few steps: a smoke test rather than a measurement.
    pub fn quick() -> Self {
        Self {
            sizes: vec![(280, 160)],
            gaussians: vec![10_000],
            budget: Budget { seconds: 0.5, steps: 10 },
            seed: 0,
        }
    }
}
