//! Two plain loops, arithmetic and copying on all threads, as a yardstick for the kernels' times.

use fearless_simd::prelude::*;
use rayon::prelude::*;

use crate::simd::{LANES, splat, vectorised};

/// Independent chains of a task: enough to hide the latency of a multiply-add.
const CHAINS: usize = 12;

/// Operations of [`multiply_adds`] per task and round; a multiply-add is two.
pub const OPERATIONS: u64 = 2 * (CHAINS * LANES) as u64;

/// Runs `rounds` fused multiply-adds of every chain in each of `tasks`. Returns a sum, so that no
/// compiler leaves them out.
pub fn multiply_adds(tasks: usize, rounds: u32) -> f32 {
    let sum = |task: usize| -> f32 {
        vectorised!(simd => {
            // They converge to 500: they neither overflow nor become subnormal.
            let (factor, offset) = (splat(simd, 0.999), splat(simd, 0.5));
            let mut chains = [splat(simd, task as f32); CHAINS];
            for _ in 0..rounds {
                for chain in &mut chains {
                    *chain = chain.mul_add(factor, offset);
                }
            }
            let mut total = 0.0;
            for chain in chains {
                for lane in chain.as_slice() {
                    total += lane;
                }
            }
            total
        })
    };
    (0..tasks).into_par_iter().map(sum).sum()
}

/// Copies an array of the same length.
pub fn copy(source: &[f32], target: &mut [f32]) {
    const PART: usize = 1 << 16;
    let parts = target.par_chunks_mut(PART).zip(source.par_chunks(PART));
    parts.for_each(|(target, source)| target.copy_from_slice(source));
}
