//! The noise of a target.

use fearless_simd::prelude::*;

use crate::simd::{F, splat};

/// Levels of brightness at which noise is known: the middles of equal parts of 0..=1.
pub const LEVELS: usize = 16;

/// The noise of a target by the brightness around a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation at the first level, and below it.
    pub first: f32,
    /// Changes of its slope at the levels; the last one makes it constant again.
    pub bends: [f32; LEVELS],
}

impl Noise {
    /// No noise.
    pub const NONE: Self = Self { first: 0.0, bends: [0.0; LEVELS] };

    /// From standard deviations at the [`LEVELS`]; linear between them.
    pub fn new(deviations: [f32; LEVELS]) -> Self {
        let slope = |n: usize| match n {
            1..LEVELS => (deviations[n] - deviations[n - 1]) * LEVELS as f32,
            _ => 0.0,
        };
        let bends = std::array::from_fn(|n| slope(n + 1) - slope(n));
        Self { first: deviations[0], bends }
    }

    /// Brightness of a level.
    fn level(n: usize) -> f32 {
        (n as f32 + 0.5) / LEVELS as f32
    }

    /// Standard deviation at these values.
    #[inline(always)]
    pub(super) fn at<S: Simd>(&self, value: F<S>) -> F<S> {
        let simd = value.witness();
        let mut deviation = splat(simd, self.first);
        for (n, &bend) in self.bends.iter().enumerate() {
            let above = (value - Self::level(n)).max(0.0);
            deviation = above.mul_add(splat(simd, bend), deviation);
        }
        deviation.max(0.0)
    }
}
