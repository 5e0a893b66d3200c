//! A step of Adam, equivalent to shaders/noise/adam.wgsl.

use fearless_simd::prelude::*;

use super::PARAMETERS;
use crate::simd::{LANES, is_finite, load_some, splat, store_some, vectorised};

const BETAS: [f64; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-8;
/// The rate falls by `DECAY` every `DECAY_STEPS` steps.
const RATE: f64 = 1e-4;
const DECAY: f64 = 0.95;
const DECAY_STEPS: u64 = 100;

/// Updates parameters and moments; `step` counts from 1. A gradient that is not finite counts as 0.
pub(super) fn step(numbers: &mut [f32], gradient: &[f32], step: u64) {
    let rate = (RATE * DECAY.powi(((step - 1) / DECAY_STEPS) as i32)) as f32;
    let corrections = BETAS.map(|beta| (1.0 - beta.powi(step as i32)) as f32);
    let (parameters, moments) = numbers.split_at_mut(PARAMETERS);
    let (first, second) = moments.split_at_mut(PARAMETERS);
    let moments = first.chunks_mut(LANES).zip(second.chunks_mut(LANES));
    let all = parameters.chunks_mut(LANES).zip(moments).zip(gradient.chunks(LANES));
    let [old_1, old_2] = BETAS.map(|beta| beta as f32);
    let [new_1, new_2] = BETAS.map(|beta| (1.0 - beta) as f32);
    vectorised!(simd => for ((parameter, (first, second)), gradient) in all {
        let g = load_some(simd, gradient);
        let g = is_finite(g).select(g, splat(simd, 0.0));
        let m = load_some(simd, first).mul_add(old_1, g * new_1);
        let v = load_some(simd, second).mul_add(old_2, g * g * new_2);
        let taken = m / corrections[0] * rate / ((v / corrections[1]).sqrt() + EPSILON);
        store_some(load_some(simd, parameter) - taken, parameter);
        store_some(m, first);
        store_some(v, second);
    });
}
