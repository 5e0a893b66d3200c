//! The brightness of the pose copies.

use crate::image::{Image, Linear, Srgb, srgb_to_linear};
use crate::mask::Mask;

/// Target sRGB level of the median.
const MEDIAN_LEVEL: f32 = 0.4;

/// Below half an 8-bit code value, a median gets no more gain and a pixel is black.
const DARKEST: f32 = 0.5 / 255.0 / 12.92;

/// Linear light from which a pixel of the photograph itself is clipped.
const CLIPPED: f32 = 0.98;

/// Share of black and clipped pixels up to which they count like all others: they hardly move the
/// median. In nine captures of rooms, courtyards and plants none has more than a quarter; an object
/// before black or white has more.
const FEW: f64 = 0.3;

/// Share of the pixels that stay below linear light 1 after the gain. In the same captures, dark
/// ones have at most 0.5 there.
const BELOW_WHITE: f64 = 0.75;

/// Largest noise after the gain, linear light, with the median at 0.13: more would only hide what
/// other parts of the photograph show. Dark captures have up to 0.02.
const MOST_NOISE: f32 = 0.1;

/// Share of the pixels that the gain may turn white.
const WHITE: f64 = 0.01;

/// Linear light below which nothing is clipped; above it values approach 1 without reaching it.
const KNEE: f32 = 0.7;

/// Linear light of the 8-bit code value 254.5, from which a value is stored as white.
const STORED_AS_WHITE: f32 = 0.9955;

/// The photograph at a brightness suited to COLMAP: one gain in linear light that brings the median
/// to [`MEDIAN_LEVEL`], and a soft clip. Masked pixels are ignored, as are black or clipped ones if
/// there are many. A photograph that is already bright is unchanged.
pub(crate) fn brightened(image: &Image<Srgb>, mask: Option<&Mask>) -> Image<Srgb> {
    let linear = image.to_linear();
    let lit = Lit::of(&linear, mask);
    let gain = lit.gain(&linear);
    let reach = lit.reach(&linear, gain);
    linear.map(|v| soft_clip(v * gain, reach)).to_srgb()
}

/// The pixels that determine the gain.
struct Lit {
    /// Mean of the channels of every pixel, linear light.
    levels: Vec<f32>,
    /// Whether a pixel counts.
    counts: Vec<bool>,
}

impl Lit {
    fn of(linear: &Image<Linear>, mask: Option<&Mask>) -> Self {
        let levels: Vec<f32> = (0..linear.pixels())
            .map(|i| (0..3).map(|channel| linear.plane(channel)[i]).sum::<f32>() / 3.0)
            .collect();
        let kept: Vec<bool> = match mask {
            Some(mask) => mask.pixels().to_vec(),
            None => vec![true; levels.len()],
        };
        let is_lit = |level: f32| (DARKEST..CLIPPED).contains(&level);
        let lit: Vec<bool> =
            kept.iter().zip(&levels).map(|(kept, level)| *kept && is_lit(*level)).collect();
        let count = |pixels: &[bool]| pixels.iter().filter(|counts| **counts).count();
        let (lit_count, kept_count) = (count(&lit), count(&kept));
        let is_few = (kept_count - lit_count) as f64 <= FEW * kept_count as f64;
        Self { levels, counts: if is_few || lit_count == 0 { kept } else { lit } }
    }

    fn gain(&self, linear: &Image<Linear>) -> f32 {
        let counted = self.counted(&self.levels);
        let Some(median) = quantile(counted.clone(), 0.5) else {
            return 1.0;
        };
        let wanted = srgb_to_linear(MEDIAN_LEVEL) / median.max(DARKEST);
        let bright = quantile(counted, BELOW_WHITE).unwrap_or(1.0);
        let noise = self.noise(linear.width());
        wanted.min(1.0 / bright).min(MOST_NOISE / noise).max(1.0)
    }

    /// Standard deviation of the noise of the levels, from the median response of Immerkaer's mask,
    /// which ignores planes and straight edges; 0 in pictures that are too small.
    fn noise(&self, width: usize) -> f32 {
        const WEIGHTS: [f32; 9] = [1.0, -2.0, 1.0, -2.0, 4.0, -2.0, 1.0, -2.0, 1.0];
        let height = self.levels.len() / width.max(1);
        let inner = (1..height.saturating_sub(1))
            .flat_map(|y| (1..width.saturating_sub(1)).map(move |x| y * width + x));
        let response = |at: usize| -> f32 {
            let near = |i: usize| self.levels[at + i / 3 * width + i % 3 - width - 1];
            (0..9).map(|i| WEIGHTS[i] * near(i)).sum()
        };
        let responses = inner.filter(|&at| self.counts[at]).map(|at| response(at).abs());
        // In a normal distribution the median is at 0.6745 deviations; the squared weights sum to
        // 36.
        quantile(responses.collect(), 0.5).unwrap_or(0.0) / 0.6745 / 6.0
    }

    /// The distance above the knee over which values approach 1, so that at most a hundredth of the
    /// pixels become white.
    fn reach(&self, linear: &Image<Linear>, gain: f32) -> f32 {
        let brightest = |i: usize| (0..3).map(|c| linear.plane(c)[i]).fold(0.0, f32::max);
        let all: Vec<f32> = (0..linear.pixels()).map(brightest).collect();
        let mut counted = self.counted(&all);
        counted.retain(|v| *v < CLIPPED);
        let most = gain * quantile(counted, 1.0 - WHITE).unwrap_or(0.0);
        let until_white = ((1.0 - KNEE) / (1.0 - STORED_AS_WHITE)).ln();
        ((most - KNEE) / until_white).max(1.0 - KNEE)
    }

    fn counted(&self, values: &[f32]) -> Vec<f32> {
        values.iter().zip(&self.counts).filter(|(_, counts)| **counts).map(|(v, _)| *v).collect()
    }
}

/// The value below which this share of the values lies; `None` if there are none.
fn quantile(mut values: Vec<f32>, share: f64) -> Option<f32> {
    let at = (values.len() as f64 * share) as usize;
    let last = values.len().checked_sub(1)?;
    let (_, value, _) = values.select_nth_unstable_by(at.min(last), f32::total_cmp);
    Some(*value)
}

/// The identity up to the knee, then an exponential approach to 1, with the same slope if `reach`
/// is the distance from the knee to 1.
fn soft_clip(value: f32, reach: f32) -> f32 {
    if value <= KNEE {
        return value;
    }
    KNEE + (1.0 - KNEE) * (1.0 - (-(value - KNEE) / reach).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 80;
    const HEIGHT: usize = 60;

    /// A smooth picture of levels from 0.15 to 0.85, sRGB, where `is_lit`, else `around`.
    fn object(around: f32, is_lit: impl Fn(usize, usize) -> bool) -> Image<Srgb> {
        let mut image = Image::new(WIDTH, HEIGHT);
        for (x, y) in (0..WIDTH * HEIGHT).map(|i| (i % WIDTH, i / WIDTH)) {
            let lit = 0.5 + 0.35 * (0.3 * x as f32).sin() * (0.2 * y as f32).cos();
            image.set(x, y, [if is_lit(x, y) { lit } else { around }; 3]);
        }
        image
    }

    fn white_share(image: &Image<Srgb>) -> f64 {
        crate::metrics::clipped_share(image)
    }

    #[test]
    fn a_dark_photograph_is_lifted_to_the_median_level_without_clipping() {
        let mut dark: Image<Srgb> = Image::new(64, 8);
        for y in 0..8 {
            for x in 0..64 {
                dark.set(x, y, [0.01 + 0.002 * x as f32; 3]);
            }
        }
        let bright = brightened(&dark, None);
        let mut levels = bright.plane(0).to_vec();
        levels.sort_by(f32::total_cmp);
        assert!((levels[levels.len() / 2] - MEDIAN_LEVEL).abs() < 0.01);
        assert!(levels.windows(2).all(|pair| pair[0] <= pair[1]) && levels[levels.len() - 1] < 1.0);
    }

    #[test]
    fn a_bright_photograph_is_unchanged() {
        let mut image: Image<Srgb> = Image::new(4, 4);
        image.data_mut().fill(0.6);
        let out = brightened(&image, None);
        assert!(out.data().iter().all(|v| (v - 0.6).abs() < 1e-4));
    }

    #[test]
    fn black_photographs_do_not_divide_by_zero() {
        let out = brightened(&Image::new(4, 4), None);
        assert!(out.data().iter().all(|v| *v == 0.0));
    }

    #[test]
    fn a_lit_object_before_black_or_nearly_black_is_unchanged() {
        for (around, edges) in
            [(0.0, [8, 20, 36, 60]), (0.004, [30, 36, 44, 60]), (0.012, [30, 36, 44, 60])]
        {
            for edge in edges {
                let image = object(around, |x, _| x < edge);
                let out = brightened(&image, None);
                assert!(white_share(&out) <= WHITE, "{around}, {edge}: {}", white_share(&out));
                let (darkest, brightest) = object_range(&out, edge);
                assert!(brightest - darkest > 0.35, "{around}, {edge}: {darkest} to {brightest}");
            }
        }
    }

    fn object_range(image: &Image<Srgb>, edge: usize) -> (f32, f32) {
        let inside = (0..WIDTH * HEIGHT).filter(|i| i % WIDTH < edge).map(|i| image.plane(0)[i]);
        inside.fold((1.0_f32, 0.0_f32), |(low, high), v| (low.min(v), high.max(v)))
    }

    #[test]
    fn a_dark_object_before_black_is_lifted_on_its_own() {
        let dark = object(0.0, |x, _| x < 30).map(|v| 0.1 * v);
        let out = brightened(&dark, None);
        let mut lit: Vec<f32> =
            (0..WIDTH * HEIGHT).filter(|i| i % WIDTH < 30).map(|i| out.plane(0)[i]).collect();
        lit.sort_by(f32::total_cmp);
        assert!((lit[lit.len() / 2] - MEDIAN_LEVEL).abs() < 0.05, "{}", lit[lit.len() / 2]);
    }

    #[test]
    fn lamps_in_a_dark_room_do_not_reduce_its_gain_and_hardly_become_white() {
        // A twentieth of the pixels is 300 times as bright as the median.
        let room = object(0.0, |_, _| true).map(|v| 0.05 * v);
        let lamps = object(0.9, |x, _| x >= 4);
        let mut image = room.clone();
        for (x, y) in (0..WIDTH * HEIGHT).map(|i| (i % WIDTH, i / WIDTH)).filter(|(x, _)| *x < 4) {
            image.set(x, y, lamps.get(x, y).map(|v| v - 0.002 * y as f32));
        }
        let (with, without) = (brightened(&image, None), brightened(&room, None));
        assert!((with.get(40, 30)[0] - without.get(40, 30)[0]).abs() < 0.05);
        assert!(white_share(&with) <= WHITE, "{}", white_share(&with));
    }

    #[test]
    fn noise_bounds_the_gain() {
        // Most pixels have one 8-bit code value, the others any of a dozen.
        let value = |i: usize| {
            let random = i.wrapping_mul(2_654_435_761) >> 9;
            let codes = if random % 10 < 7 { 1 } else { random / 10 % 13 };
            codes as f32 / 255.0
        };
        let data = (0..3 * WIDTH * HEIGHT).map(|i| value(i % (WIDTH * HEIGHT))).collect();
        let noise = Image::from_planar(WIDTH, HEIGHT, data);
        let out = brightened(&noise, None);
        let level = |at: f64| quantile(out.plane(0).to_vec(), at).expect("pixels");
        assert!(level(0.5) < 0.9 * MEDIAN_LEVEL, "{}", level(0.5));
        assert!(level(0.99) < 0.95, "{}", level(0.99));
        let noise = Lit::of(&out.to_linear(), None).noise(WIDTH);
        assert!(noise < 1.01 * MOST_NOISE, "{noise}");
    }

    #[test]
    fn masked_pixels_do_not_affect_the_gain() {
        let dark = object(0.0, |_, _| true).map(|v| 0.1 * v);
        let mut covered = dark.clone();
        (0..WIDTH * HEIGHT).filter(|i| i % WIDTH < 60).for_each(|i| {
            covered.set(i % WIDTH, i / WIDTH, [0.9; 3]);
        });
        let kept = (0..WIDTH * HEIGHT).map(|i| i % WIDTH >= 60).collect();
        let mask = Mask::new(WIDTH, HEIGHT, kept);
        let (with, without) = (brightened(&covered, Some(&mask)), brightened(&dark, Some(&mask)));
        assert_eq!(with.get(70, 30), without.get(70, 30));
        assert!(brightened(&covered, None).get(70, 30)[0] < 0.5 * with.get(70, 30)[0]);
    }
}
