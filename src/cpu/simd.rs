//! Sixteen lanes, and the functions for which the standard library uses the platform's own, which
//! differ in the last bit between machines.

use fearless_simd::prelude::*;
use fearless_simd::{Level, f32x16, i32x16, mask32x16, u32x16};

/// Lanes of a vector: sixteen pixels of a row, or sixteen Gaussians.
pub const LANES: usize = 16;

/// A vector in memory.
pub type Lanes = [f32; LANES];

pub(crate) type F<S> = f32x16<S>;
pub(crate) type M<S> = mask32x16<S>;

/// Whether the kernels run on this processor: they need AVX2, or the vectors of another
/// architecture.
pub fn is_supported() -> bool {
    #[cfg(target_arch = "x86_64")]
    return Level::new().as_avx2().is_some();
    #[cfg(not(target_arch = "x86_64"))]
    return !Level::new().is_fallback();
}

/// The vectors that the kernels use on this processor.
pub fn vectors() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    return if Level::new().as_avx512().is_some() { "AVX-512" } else { "AVX2" };
    #[cfg(not(target_arch = "x86_64"))]
    return "vectors of its architecture";
}

/// Runs a kernel with the widest instructions of this processor. There is no version without
/// AVX2: sixteen scalars for a vector are slower than any other way, and take minutes to compile.
#[cfg(target_arch = "x86_64")]
macro_rules! vectorised {
    ($simd:ident => $kernel:expr) => {{
        let level = $crate::simd::level();
        if let Some($simd) = level.as_avx512() {
            fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $kernel,
            )
        } else {
            let $simd = level.as_avx2().expect("a processor that is_supported");
            fearless_simd::Simd::vectorize(
                $simd,
                #[inline(always)]
                || $kernel,
            )
        }
    }};
}
#[cfg(not(target_arch = "x86_64"))]
macro_rules! vectorised {
    ($simd:ident => $kernel:expr) => {
        fearless_simd::dispatch!($crate::simd::level(), $simd => $kernel)
    };
}
pub(crate) use vectorised;

/// An array of an expression's values, always inlined. `map` is not, and a closure that is not
/// inlined is compiled for the oldest processors.
macro_rules! each {
    ([$($value:expr),+] $name:ident => $body:expr) => {
        [$({
            let $name = $value;
            $body
        }),+]
    };
}
pub(crate) use each;

#[cfg(not(test))]
#[inline(always)]
pub(crate) fn level() -> Level {
    Level::new()
}

/// Whether tests keep to AVX2.
#[cfg(test)]
pub(crate) static NARROW: std::sync::atomic::AtomicBool = std::sync::atomic::AtomicBool::new(false);

#[cfg(test)]
pub(crate) fn level() -> Level {
    let level = Level::new();
    match level.as_avx2() {
        Some(avx2) if NARROW.load(std::sync::atomic::Ordering::Relaxed) => Level::Avx2(avx2),
        _ => level,
    }
}

#[inline(always)]
pub(crate) fn load<S: Simd>(simd: S, lanes: &Lanes) -> F<S> {
    f32x16::from_slice(simd, lanes)
}

#[inline(always)]
pub(crate) fn splat<S: Simd>(simd: S, value: f32) -> F<S> {
    f32x16::splat(simd, value)
}

/// The first lanes from at most sixteen numbers, the others 0.
#[inline(always)]
pub(crate) fn load_some<S: Simd>(simd: S, numbers: &[f32]) -> F<S> {
    if let Ok(lanes) = <&Lanes>::try_from(numbers) {
        return load(simd, lanes);
    }
    let mut lanes = [0.0; LANES];
    for (lane, number) in lanes.iter_mut().zip(numbers) {
        *lane = *number;
    }
    load(simd, &lanes)
}

/// Stores the first lanes to at most sixteen numbers.
#[inline(always)]
pub(crate) fn store_some<S: Simd>(vector: F<S>, numbers: &mut [f32]) {
    if let Ok(lanes) = <&mut Lanes>::try_from(&mut *numbers) {
        return vector.store_slice(lanes);
    }
    for (number, lane) in numbers.iter_mut().zip(vector.as_slice()) {
        *number = *lane;
    }
}

/// 0, 1 .. 15.
#[inline(always)]
pub(crate) fn ramp<S: Simd>(simd: S) -> F<S> {
    load(simd, &[0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.])
}

/// 1.5 * 2^23: adding it rounds to a whole number, which is in the lowest bits.
pub(crate) const ROUND: f32 = 12_582_912.0;

/// The polynomial of 2^x between -1/2 and 1/2 below its highest coefficient. The linear coefficient
/// is not exactly the logarithm of 2.
#[expect(clippy::approx_constant, reason = "the best polynomial, not the series")]
const EXP2: [f32; 5] = [0.009_675_541, 0.055_507_133, 0.240_221_2, 0.693_147, 1.000_000_1];

/// 2^x for x of at least -125, and 2^-125 below; x at most 127. The polynomial's relative error is
/// below 7.5e-8, the whole below 2e-7.
#[inline(always)]
pub(crate) fn exp2<S: Simd>(x: F<S>) -> F<S> {
    let x = x.max(-125.0);
    let shifted = x + ROUND;
    let part = x - (shifted - ROUND);
    let simd = x.witness();
    let mut power = splat(simd, 0.001_327_647_2);
    for coefficient in EXP2 {
        power = power.mul_add(part, coefficient);
    }
    let exponent = shifted.bitcast::<i32x16<S>>() << 23;
    (power.bitcast::<i32x16<S>>() + exponent).bitcast()
}

/// Logarithm to base 2 of a normal positive number; the absolute error is below 3e-7 near 1, and
/// relative elsewhere.
#[inline(always)]
pub(crate) fn log2<S: Simd>(x: F<S>) -> F<S> {
    const HALF_ROOT: i32 = 0x3f35_04f3;
    let simd = x.witness();
    let bits = x.bitcast::<i32x16<S>>() - HALF_ROOT;
    let exponent = bits >> 23;
    let mantissa: F<S> = (x.bitcast::<i32x16<S>>() - (exponent << 23)).bitcast();
    // ln m = 2 artanh((m - 1) / (m + 1)).
    let ratio = (mantissa - 1.0) / (mantissa + 1.0);
    let square = ratio * ratio;
    let mut series = splat(simd, 1.0 / 9.0);
    for coefficient in [1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0] {
        series = series.mul_add(square, coefficient);
    }
    let whole: F<S> = exponent.to_float();
    (series * ratio).mul_add(2.0 * std::f32::consts::LOG2_E, whole)
}

/// The part of the logarithm of e that f32 leaves out.
const LOG2_E_REST: f32 = 1.925_963e-8;

#[inline(always)]
pub(crate) fn exp<S: Simd>(x: F<S>) -> F<S> {
    // In two parts, so that large arguments keep their digits.
    let high = x * std::f32::consts::LOG2_E;
    let low = x.mul_add(std::f32::consts::LOG2_E, -high);
    let low = x.mul_add(LOG2_E_REST, low);
    let power = exp2(high.min(127.0));
    (power * low).mul_add(std::f32::consts::LN_2, power)
}

#[inline(always)]
pub(crate) fn ln<S: Simd>(x: F<S>) -> F<S> {
    log2(x) * std::f32::consts::LN_2
}

#[inline(always)]
pub(crate) fn sigmoid<S: Simd>(x: F<S>) -> F<S> {
    let one = splat(x.witness(), 1.0);
    one / (exp(-x.max(-80.0).min(80.0)) + 1.0)
}

/// Sine of `turns` in 0..=1, absolute error below 3e-7.
#[inline(always)]
pub(crate) fn sine_of_turns<S: Simd>(turns: F<S>) -> F<S> {
    let simd = turns.witness();
    // sin(2 pi u) = -sin(2 pi (u - 1/2)), and that is symmetric about a quarter.
    let centred = turns - 0.5;
    let folded = (splat(simd, 0.5) - centred.abs()).min(centred.abs());
    let square = folded * folded;
    let mut series = splat(simd, 39.710_92);
    for coefficient in [-76.574_99, 81.602_23, -41.341_675, std::f32::consts::TAU] {
        series = series.mul_add(square, coefficient);
    }
    let sine = series * folded;
    centred.simd_lt(0.0).select(sine, -sine)
}

/// Finite, and with a finite square.
#[inline(always)]
pub(crate) fn fits<S: Simd>(x: F<S>) -> M<S> {
    x.abs().simd_lt(1e18)
}

#[inline(always)]
pub(crate) fn is_finite<S: Simd>(x: F<S>) -> M<S> {
    x.abs().simd_le(f32::MAX)
}

/// Sum of the lanes, always in the same order.
#[inline(always)]
pub(crate) fn sum<S: Simd>(x: F<S>) -> f32 {
    let (low, high) = x.split();
    let (low, high) = (low + high).split();
    let four = low + high;
    (four[0] + four[2]) + (four[1] + four[3])
}

/// Four random words of (seed, step, id, a constant), for sixteen ids: Mark Jarzynski and Marc
/// Olano, "Hash Functions for GPU Rendering", 2020: pcg4d.
#[inline(always)]
fn hash4<S: Simd>(key: [u32x16<S>; 4]) -> [u32x16<S>; 4] {
    let [mut x, mut y, mut z, mut w] = each!([0, 1, 2, 3] n => key[n] * 1_664_525 + 1_013_904_223);
    x += y * w;
    y += z * x;
    z += x * y;
    w += y * z;
    [x, y, z, w] = each!([x, y, z, w] v => v ^ (v >> 16));
    x += y * w;
    y += z * x;
    z += x * y;
    w += y * z;
    [x, y, z, w]
}

/// Three independent standard normal numbers a lane (Box and Muller), a pure function of seed, step
/// and id.
#[inline(always)]
pub(crate) fn normal3<S: Simd>(simd: S, seed: u32, step: u32, first: u32) -> [F<S>; 3] {
    let [seed, step, first, salt] =
        each!([seed, step, first, 0x9e37_79b9] value => u32x16::splat(simd, value));
    let lanes = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
    let words = hash4([seed, step, first + u32x16::from_slice(simd, &lanes), salt]);
    let [a, b, c, d] = each!([0, 1, 2, 3] n => {
        let upper: F<S> = (words[n] >> 8).to_float();
        (upper + 0.5) * (1.0 / 16_777_216.0)
    });
    let [near, far] = each!([a, c] u => (ln(u) * -2.0).sqrt());
    // cos(2 pi u) = sin(2 pi (u + 1/4)).
    let [quarter_b, quarter_d] = each!([b, d] u => {
        let moved = u + 0.25;
        moved.simd_lt(1.0).select(moved, moved - 1.0)
    });
    [near * sine_of_turns(quarter_b), near * sine_of_turns(b), far * sine_of_turns(quarter_d)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error of `found` against `expected` over the values, relative above 1.
    fn worst(
        values: &[f32],
        expected: impl Fn(f64) -> f64,
        found: impl Fn(&Lanes) -> Lanes,
    ) -> f64 {
        let error = |value: f32, found: f32| {
            let right = expected(f64::from(value));
            (f64::from(found) - right).abs() / right.abs().max(1e-30)
        };
        let (rows, _) = values.as_chunks::<LANES>();
        let pairs = rows.iter().flat_map(|row| row.iter().copied().zip(found(row)));
        pairs.map(|(value, found)| error(value, found)).fold(0.0, f64::max)
    }

    macro_rules! lanes {
        ($kernel:ident) => {
            |row: &Lanes| -> Lanes {
                let mut out = [0.0; LANES];
                vectorised!(simd => $kernel(load(simd, row)).store_slice(&mut out));
                out
            }
        };
    }

    fn between(low: f32, high: f32) -> Vec<f32> {
        (0..16_000).map(|n| low + (high - low) * (n as f32 + 0.3) / 16_000.0).collect()
    }

    #[test]
    fn exponentials_and_logarithms_have_their_stated_errors() {
        let exp2_error = worst(&between(-20.0, 20.0), f64::exp2, lanes!(exp2));
        assert!(exp2_error < 2e-7, "{exp2_error}");
        let exp_error = worst(&between(-60.0, 60.0), f64::exp, lanes!(exp));
        assert!(exp_error < 3e-7, "{exp_error}");
        let log_error = worst(&between(1.5, 4e6), f64::log2, lanes!(log2));
        assert!(log_error < 3e-7, "{log_error}");
        let small = worst(&between(1e-6, 0.7), f64::ln, lanes!(ln));
        assert!(small < 4e-7, "{small}");
        let error = worst(&between(-10.0, 10.0), |x| 1.0 / (1.0 + (-x).exp()), lanes!(sigmoid));
        assert!(error < 4e-7, "{error}");
        assert!(worst(&between(-20.0, 20.0), |x| 1.000_001 * x.exp2(), lanes!(exp2)) > 5e-7);
    }

    #[test]
    fn a_sine_has_its_stated_error() {
        let turns = between(0.0, 1.0);
        let found: Vec<_> =
            turns.as_chunks::<LANES>().0.iter().flat_map(lanes!(sine_of_turns)).collect();
        for (turns, found) in turns.iter().zip(found) {
            let right = (std::f64::consts::TAU * f64::from(*turns)).sin();
            assert!((f64::from(found) - right).abs() < 4e-7, "{turns}: {found} {right}");
        }
    }

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let mut all = Vec::new();
        for first in (0..40_000).step_by(LANES) {
            vectorised!(simd => for axis in normal3(simd, 7, 3, first) {
                all.extend_from_slice(axis.as_slice());
            });
        }
        let mean = all.iter().sum::<f32>() / all.len() as f32;
        let square = all.iter().map(|v| v * v).sum::<f32>() / all.len() as f32;
        assert!(mean.abs() < 0.01 && (square - 1.0).abs() < 0.02, "{mean} {square}");
    }
}
