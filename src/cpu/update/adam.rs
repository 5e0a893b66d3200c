//! Adam, with the regularisers and the exploration of MCMC.

use fearless_simd::prelude::*;

use super::Step;
use super::gradient::{Gradient, moves};
use crate::View;
use crate::population::column;
use crate::project::harmonics::coefficients;
use crate::simd::{F, LANES, Lanes, M, each, is_finite, ln, load, normal3, sigmoid, splat};
use crate::vector::{V3, dot, length, scaled, symmetric};

const BETAS: [f32; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-15;
/// Largest standard deviation along the line of sight, as a share of the depth. EWA is linear about
/// the centre: a sheet that recedes farther, like those of a sky, covers the view like fog.
const DEEPEST: f32 = 0.25;

/// A block of the population.
pub(super) struct Numbers<'a> {
    pub(super) values: &'a mut [Lanes],
    pub(super) first: &'a mut [Lanes],
    pub(super) second: &'a mut [Lanes],
    /// Lengths of the gradients by position, and views.
    pub(super) lengths: &'a mut [Lanes; 2],
}

#[inline(always)]
pub(super) fn update<S: Simd>(
    simd: S,
    block: usize,
    numbers: &mut Numbers<'_>,
    gradient: &Gradient<S>,
    (view, step): (&View, &Step),
) {
    let updates = gradient.shape.usable & gradient.fits;
    let geometry = geometry(simd, block, numbers, gradient, (view, step));
    for (at, &(value, by)) in geometry.iter().enumerate() {
        let rate = match at {
            column::MEAN..column::LOG_SCALE => step.rates[0],
            column::LOG_SCALE..column::QUAT => step.rates[1],
            column::QUAT..column::LOGIT => step.rates[2],
            _ => step.rates[3],
        };
        advance(numbers, at, (value, by), (rate, step.bias), updates);
    }
    // Inactive coefficients have no gradient and no moments, so they do not change.
    for harmonic in 0..3 * coefficients(view.sh_degree) {
        let at = column::HARMONICS + harmonic;
        let rate = if harmonic < 3 { step.rate_sh0 } else { step.rate_sh };
        let value = load(simd, &numbers.values[at]);
        let by = gradient.number(simd, at, view.sh_degree);
        advance(numbers, at, (value, by), (rate, step.bias), updates);
    }
    if step.accumulates {
        let size = view.size.map(|pixels| 0.5 * pixels as f32);
        let [x, y] = each!([0, 1] n => gradient.by_place[n] * size[n]);
        let sums = [length([x, y, splat(simd, 0.0)]), splat(simd, 1.0)];
        let seen = updates & gradient.touched;
        for (lanes, sum) in numbers.lengths.iter_mut().zip(sums) {
            let before = load(simd, lanes);
            seen.select(before + sum, before).store_slice(lanes);
        }
    }
}

/// The geometry's numbers before Adam's update, and their gradients with the regularisers.
#[inline(always)]
fn geometry<S: Simd>(
    simd: S,
    block: usize,
    numbers: &Numbers<'_>,
    gradient: &Gradient<S>,
    (view, step): (&View, &Step),
) -> [(F<S>, F<S>); column::HARMONICS] {
    let shape = &gradient.shape;
    let zero = splat(simd, 0.0);
    let mut out = [(zero, zero); column::HARMONICS];
    for (at, pair) in out.iter_mut().enumerate() {
        *pair = (load(simd, &numbers.values[at]), gradient.geometry[at]);
    }
    out[column::LOGIT].1 +=
        shape.opacity * (splat(simd, 1.0) - shape.opacity) * step.opacity_weight;
    let deepest = deepest(gradient, view);
    for axis in 0..3 {
        let (value, by) = out[column::LOG_SCALE + axis];
        let by = shape.scale[axis].mul_add(step.scale_weight, by);
        out[column::LOG_SCALE + axis] = (
            gradient.touched.select(value.min(deepest[axis]), value),
            moves(value).select(by, zero),
        );
    }
    if step.noise > 0.0 {
        let moved = exploration(simd, block, gradient, step);
        for n in 0..3 {
            out[column::MEAN + n].0 += moved[n];
        }
    }
    out
}

/// Adam's update of a row of numbers with its moments, where the mask is set.
#[inline(always)]
fn advance<S: Simd>(
    numbers: &mut Numbers<'_>,
    at: usize,
    (value, by): (F<S>, F<S>),
    (rate, bias): (f32, [f32; 2]),
    updates: M<S>,
) {
    let simd = value.witness();
    let before = each!([&numbers.first[at], &numbers.second[at]] lanes => load(simd, lanes));
    let m = before[0].mul_add(BETAS[0], by * (1.0 - BETAS[0]));
    let v = before[1].mul_add(BETAS[1], by * by * (1.0 - BETAS[1]));
    let taken = m * (rate * bias[0]) / ((v * bias[1]).sqrt() + EPSILON);
    let old = load(simd, &numbers.values[at]);
    updates.select(value - taken, old).store_slice(&mut numbers.values[at]);
    updates.select(m, before[0]).store_slice(&mut numbers.first[at]);
    updates.select(v, before[1]).store_slice(&mut numbers.second[at]);
}

/// The largest log-scales by which no axis recedes too far from the camera.
#[inline(always)]
fn deepest<S: Simd>(gradient: &Gradient<S>, view: &View) -> V3<S> {
    let depth = gradient.flat.point[2];
    let forward = each!([0, 1, 2] n => splat(depth.witness(), view.rows[2][n]));
    each!([0, 1, 2] axis => {
        let recede = dot(forward, gradient.shape.rotation[axis]).abs().max(1e-6);
        ln(depth * DEEPEST / recede)
    })
}

/// Exploration of MCMC: a normal step shaped by the covariance, large where the opacity is small.
#[inline(always)]
fn exploration<S: Simd>(simd: S, block: usize, gradient: &Gradient<S>, step: &Step) -> V3<S> {
    let shape = &gradient.shape;
    let gate = sigmoid((shape.opacity - 0.005) * -100.0) * step.noise;
    let normal = normal3(simd, step.seed, step.step, (block * LANES) as u32);
    let moved = scaled(symmetric(&shape.covariance, normal), gate);
    let finite = is_finite(moved[0]) & is_finite(moved[1]) & is_finite(moved[2]);
    each!([0, 1, 2] n => finite.select(moved[n], splat(simd, 0.0)))
}
