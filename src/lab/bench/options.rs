//! What to measure, and for how long.

use serde::Serialize;

/// Most steps of a case, so that warm-up and both halves of a case lie inside the round.
pub const MOST_STEPS: u32 = 2_000;

/// How long a case takes, twice: once without timestamps, once with them. What comes first ends it,
/// after three steps, or after one that is longer than the seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Budget {
    /// Seconds.
    pub seconds: f64,
    /// Steps.
    pub steps: u32,
}

/// What to measure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchOptions {
    /// Widths and heights of the images, px.
    pub sizes: Vec<(usize, usize)>,
    /// Numbers of Gaussians, and of keys to sort.
    pub gaussians: Vec<usize>,
    /// How long a case takes.
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
            budget: Budget {
                seconds: 5.0,
                steps: 100,
            },
            seed: 0,
        }
    }
}

impl BenchOptions {
    /// One small size and a few steps: shows that everything runs, and measures little.
    pub fn quick() -> Self {
        Self {
            sizes: vec![(280, 160)],
            gaussians: vec![10_000],
            budget: Budget {
                seconds: 0.5,
                steps: 10,
            },
            seed: 0,
        }
    }
}
