//! Sines and cosines of positions and directions.

use fearless_simd::prelude::*;
use fearless_simd::{i32x16, u32x16};

use crate::View;
use crate::simd::{F, LANES, Lanes, ROUND, each, ramp, splat};
use crate::vector::{V3, length, scaled};

const OCTAVES: usize = 10;
const DIRECTION_OCTAVES: usize = 4;

/// Numbers of one coordinate of a position: itself, then sine and cosine of every octave.
pub(super) const COORDINATE: usize = 1 + 2 * OCTAVES;
/// Numbers of a direction: itself, then sines and cosines of every octave, three each.
pub(super) const DIRECTION: usize = 3 + 6 * DIRECTION_OCTAVES;

/// The third coordinate of every position.
const DEPTH: f32 = 32.0 / 63.0 - 1.0;

/// The part of a quarter turn that f32 leaves out.
const QUARTER_REST: f32 = -4.371_139e-8;

/// Sine and cosine of |x| up to 600, absolute errors below 1e-7.
#[inline(always)]
pub(super) fn sin_cos<S: Simd>(x: F<S>) -> [F<S>; 2] {
    let simd = x.witness();
    let shifted = x.mul_add(std::f32::consts::FRAC_2_PI, ROUND);
    let quarters = shifted - ROUND;
    let part = quarters.mul_add(-std::f32::consts::FRAC_PI_2, x);
    let part = quarters.mul_add(-QUARTER_REST, part);
    let square = part * part;
    let mut sine = splat(simd, -1.951_529_6e-4);
    for coefficient in [8.332_161e-3, -1.666_665_5e-1] {
        sine = sine.mul_add(square, coefficient);
    }
    let sine = (sine * square).mul_add(part, part);
    let mut cosine = splat(simd, 2.443_315_7e-5);
    for coefficient in [-1.388_731_6e-3, 4.166_664_6e-2, -0.5, 1.0] {
        cosine = cosine.mul_add(square, coefficient);
    }
    let quarter = shifted.bitcast::<i32x16<S>>();
    let odd = (quarter & 1).simd_eq(1);
    // The sine is negative in the quarters 2 and 3, the cosine in 1 and 2.
    let values = [odd.select(cosine, sine), odd.select(sine, cosine)];
    let signs = each!([quarter, quarter + 1] n => (n.bitcast::<u32x16<S>>() & 2) << 30);
    each!([0, 1] n => (values[n].bitcast::<u32x16<S>>() ^ signs[n]).bitcast())
}

/// The numbers of the coordinates in -1..=1 of `count` pixels along one side of an image.
#[inline(always)]
pub(super) fn side<S: Simd>(simd: S, count: usize) -> Vec<[f32; COORDINATE]> {
    let mut out = Vec::with_capacity(count + LANES);
    for first in (0..count).step_by(LANES) {
        let pixel = ramp(simd) + (first as f32 + 0.5);
        encode_coordinate(pixel * 2.0 / count as f32 - 1.0, &mut out);
    }
    out.truncate(count);
    out
}

/// The numbers of the third coordinate.
#[inline(always)]
pub(super) fn depth<S: Simd>(simd: S) -> [f32; COORDINATE] {
    let mut out = Vec::new();
    encode_coordinate(splat(simd, DEPTH), &mut out);
    out[0]
}

#[inline(always)]
fn encode_coordinate<S: Simd>(value: F<S>, out: &mut Vec<[f32; COORDINATE]>) {
    let mut numbers = [[0.0; LANES]; COORDINATE];
    value.store_slice(&mut numbers[0]);
    for octave in 0..OCTAVES {
        let [sine, cosine] = sin_cos(value * (1 << octave) as f32);
        sine.store_slice(&mut numbers[1 + 2 * octave]);
        cosine.store_slice(&mut numbers[2 + 2 * octave]);
    }
    for lane in 0..LANES {
        let mut row = [0.0; COORDINATE];
        row.iter_mut().zip(&numbers).for_each(|(number, lanes)| *number = lanes[lane]);
        out.push(row);
    }
}

/// The directions in the world of the sixteen pixels from (x, y), encoded.
#[inline(always)]
pub(super) fn direction<S: Simd>(
    simd: S,
    view: &View,
    [x, y]: [usize; 2],
    out: &mut [Lanes; DIRECTION],
) {
    let across = (ramp(simd) + (x as f32 + 0.5 - view.centre[0])) / view.focal[0];
    let down = splat(simd, (y as f32 + 0.5 - view.centre[1]) / view.focal[1]);
    let [right, below, ahead] = &view.rows;
    let world: V3<S> = each!([0, 1, 2] n => {
        across.mul_add(right[n], down.mul_add(below[n], splat(simd, ahead[n])))
    });
    let unit = scaled(world, splat(simd, 1.0) / length(world));
    for n in 0..3 {
        unit[n].store_slice(&mut out[n]);
        for octave in 0..DIRECTION_OCTAVES {
            let [sine, cosine] = sin_cos(unit[n] * (1 << octave) as f32);
            sine.store_slice(&mut out[3 + 6 * octave + n]);
            cosine.store_slice(&mut out[6 + 6 * octave + n]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::{load, vectorised};

    #[test]
    fn sines_and_cosines_have_their_stated_errors() {
        let mut worst = [0.0_f64; 2];
        for n in 0..40_000 {
            let x: Lanes = std::array::from_fn(|lane| {
                600.0 * ((LANES * n + lane) as f32 / (20_000 * LANES) as f32 - 1.0)
            });
            let mut found = [[0.0; LANES]; 2];
            vectorised!(simd => {
                let values = sin_cos(load(simd, &x));
                values[0].store_slice(&mut found[0]);
                values[1].store_slice(&mut found[1]);
            });
            for (lane, x) in x.iter().enumerate() {
                let right = [f64::from(*x).sin(), f64::from(*x).cos()];
                for n in 0..2 {
                    worst[n] = worst[n].max((f64::from(found[n][lane]) - right[n]).abs());
                }
            }
        }
        assert!(worst.iter().all(|&error| error < 1e-7 && error > 1e-9), "{worst:?}");
    }
}
