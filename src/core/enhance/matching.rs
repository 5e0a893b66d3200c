//! Fits the curve that maps a render to the brightness of the next round (method 6).
//!
//! `f(P) = MSE(e, H) + (1 - SSIM(e, H)) + (1 - correlation(hist(e), hist(H)))` with `e = E(R; P)`,
//! equal weights, on small images. In float and with soft bins f is smooth, so small images find
//! the same optimum as large ones.
//!
//! The paper does not say: the weights of the three terms, the bins of the histograms, and the size
//! of the images.
//!
//! SSIM is that of the luma, not of each channel: the curve preserves hue and saturation, so the
//! channels would add the same information at three times the cost. Images are never compared above
//! 112 px, even where a quarter would be more.

use crate::image::{Image, Srgb};

use super::curve::value;
use super::evolution::Evolution;
use super::{Anchor, Histogram, MAX_ALPHA, MIN_GAMMA, ToneCurve};

/// Range of stops between two rounds, or between dark photographs and a network's brightening.
const STOPS: (f64, f64) = (-1.0, 12.0);
/// Most light that is subtracted or added, white being 1.
const BLACK: f64 = 0.05;

/// Images are compared at a quarter of their size, with a longer side of at most this.
const MAX_SIDE: usize = 112;

/// Bins of the soft histogram over all three channels.
const SOFT_BINS: usize = 64;

/// SSIM's constants for a range of 1.
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

/// SSIM's window: 11 taps of a Gaussian of sigma 1.5.
const TAPS: usize = 11;

/// The result of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// P_R: the arguments of the curve from the renders to the next brightness.
    pub anchor: Anchor,
    /// f at the anchor: 0 is a perfect match, at most about 4.
    pub cost: f64,
    /// Generations of the search, at most 30.
    pub generations: u32,
}

/// Finds the anchor, of the family of `like`, whose curve over `histogram` brings the renders
/// closest to the images of the next round. `pairs` are (render, target) of equal size, a few for
/// the scene (see [`spread_indices`]) or one view; `histogram` is the one that the final curve will
/// use. The result depends only on the arguments and the seed.
///
/// # Panics
/// Without pairs, or when a pair differs in size: faults of the caller.
pub fn match_anchor(
    pairs: &[(&Image<Srgb>, &Image<Srgb>)],
    histogram: &Histogram,
    like: Anchor,
    seed: u64,
) -> Match {
    assert!(!pairs.is_empty(), "nothing to match");
    let scenes: Vec<Pair> =
        pairs.iter().map(|(render, target)| Pair::new(render, target)).collect();
    let anchor_at = |[first, second]: [f64; 2]| match like {
        Anchor::Exposure { .. } => Anchor::Exposure {
            ev: STOPS.0 + first * (STOPS.1 - STOPS.0),
            black: BLACK * (2.0 * second - 1.0),
        },
        Anchor::Equalised { .. } => Anchor::Equalised {
            alpha: first * MAX_ALPHA,
            gamma: MIN_GAMMA + second * (1.0 - MIN_GAMMA),
        },
    };
    let search = match like {
        Anchor::Exposure { .. } => Evolution::EXPOSURE,
        Anchor::Equalised { .. } => Evolution::PAPER,
    };
    let best =
        search.minimise(seed, |point| cost(&scenes, &ToneCurve::new(histogram, anchor_at(point))));
    Match { anchor: anchor_at(best.point), cost: best.cost, generations: best.generations }
}

/// At most `most` indices spread evenly over `0..count`, first and last included.
pub fn spread_indices(count: usize, most: usize) -> Vec<usize> {
    let taken = count.min(most);
    match taken {
        0 => Vec::new(),
        1 => vec![count / 2],
        _ => (0..taken).map(|i| i * (count - 1) / (taken - 1)).collect(),
    }
}

/// One reduced render and its target, with all that does not depend on the anchor precomputed.
struct Pair {
    width: usize,
    height: usize,
    render: Vec<[f32; 3]>,
    target: Vec<[f32; 3]>,
    target_histogram: [f64; SOFT_BINS],
    target_luma: Vec<f32>,
    target_mean: Vec<f32>,
    target_square: Vec<f32>,
}

impl Pair {
    fn new(render: &Image<Srgb>, target: &Image<Srgb>) -> Self {
        let size = (render.width(), render.height());
        assert_eq!(size, (target.width(), target.height()), "a render and its target");
        let (width, height) = small_size(size);
        let colours = |image: &Image<Srgb>| {
            let small = image.resize_area(width, height);
            let at = |i| std::array::from_fn(|channel| small.plane(channel)[i]);
            (0..small.pixels()).map(at).collect::<Vec<[f32; 3]>>()
        };
        let (render, target) = (colours(render), colours(target));
        let mut target_histogram = [0.0; SOFT_BINS];
        target.iter().for_each(|&rgb| count(&mut target_histogram, rgb));
        let target_luma: Vec<f32> = target.iter().copied().map(luma).collect();
        let blur = Blur { width, height };
        let target_mean = blur.apply(&target_luma);
        let target_square = blur.apply(&product(&target_luma, &target_luma));
        Self {
            width,
            height,
            render,
            target,
            target_histogram,
            target_luma,
            target_mean,
            target_square,
        }
    }

    /// Mean SSIM of a luma against the target's, over the region where the window fits.
    fn ssim(&self, luma: &[f32]) -> f64 {
        let blur = Blur { width: self.width, height: self.height };
        let mean = blur.apply(luma);
        let square = blur.apply(&product(luma, luma));
        let cross = blur.apply(&product(luma, &self.target_luma));
        let ssim = |i: usize| {
            let (m, t) = (mean[i], self.target_mean[i]);
            let (variance, target_variance) = (square[i] - m * m, self.target_square[i] - t * t);
            let covariance = cross[i] - m * t;
            f64::from(
                (2.0 * m * t + C1) * (2.0 * covariance + C2)
                    / ((m * m + t * t + C1) * (variance + target_variance + C2)),
            )
        };
        (0..mean.len()).map(ssim).sum::<f64>() / mean.len() as f64
    }
}

/// A quarter of the size, at most [`MAX_SIDE`], but at least twice SSIM's window unless the image
/// itself is smaller.
fn small_size((width, height): (usize, usize)) -> (usize, usize) {
    let factor = (width.max(height) as f64 / MAX_SIDE as f64).max(4.0);
    let side = |side: usize| ((side as f64 / factor).round() as usize).max(2 * TAPS).min(side);
    (side(width), side(height))
}

/// f of method 6 for one curve.
fn cost(pairs: &[Pair], curve: &ToneCurve) -> f64 {
    let fast = FastCurve::new(curve);
    let (mut squares, mut samples, mut ssim) = (0.0, 0.0, 0.0);
    let (mut histogram, mut target_histogram) = ([0.0; SOFT_BINS], [0.0; SOFT_BINS]);
    for pair in pairs {
        let mut lumas = Vec::with_capacity(pair.render.len());
        for (&render, target) in pair.render.iter().zip(&pair.target) {
            let enhanced = fast.apply(render);
            let square = |(a, b): (f32, &f32)| (a - b) * (a - b);
            squares += f64::from(enhanced.into_iter().zip(target).map(square).sum::<f32>());
            count(&mut histogram, enhanced);
            lumas.push(luma(enhanced));
        }
        samples += 3.0 * pair.render.len() as f64;
        ssim += pair.ssim(&lumas) / pairs.len() as f64;
        target_histogram.iter_mut().zip(&pair.target_histogram).for_each(|(sum, bin)| *sum += bin);
    }
    squares / samples + (1.0 - ssim) + (1.0 - correlation(&histogram, &target_histogram))
}

/// A tone curve with its channels tabulated over the square root of the value, where even gamma 0.3
/// is nearly straight: a power per channel would take most of the search's time.
struct FastCurve<'a> {
    curve: &'a ToneCurve,
    channels: Vec<f32>,
}

impl<'a> FastCurve<'a> {
    const STEPS: usize = 4096;

    fn new(curve: &'a ToneCurve) -> Self {
        let root = |i: usize| i as f32 / Self::STEPS as f32;
        Self {
            curve,
            channels: (0..=Self::STEPS).map(|i| curve.channel(root(i) * root(i))).collect(),
        }
    }

    fn apply(&self, rgb: [f32; 3]) -> [f32; 3] {
        let gain = self.curve.gain(value(rgb));
        rgb.map(|channel| {
            let position = (channel * gain).clamp(0.0, 1.0).sqrt() * Self::STEPS as f32;
            let low = (position as usize).min(Self::STEPS - 1);
            self.channels[low]
                + (position - low as f32) * (self.channels[low + 1] - self.channels[low])
        })
    }
}

/// Adds a colour's three channels to a histogram, each shared between its two bins.
fn count(histogram: &mut [f64; SOFT_BINS], rgb: [f32; 3]) {
    for channel in rgb {
        let position = channel.clamp(0.0, 1.0) * (SOFT_BINS - 1) as f32;
        let low = (position as usize).min(SOFT_BINS - 2);
        let share = f64::from(position - low as f32);
        histogram[low] += 1.0 - share;
        histogram[low + 1] += share;
    }
}

/// Pearson's correlation; 0 if either is flat.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut cross, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        cross += a * b;
        square_a += a * a;
        square_b += b * b;
    }
    let scale = (square_a * square_b).sqrt();
    if scale > 0.0 { cross / scale } else { 0.0 }
}

fn luma(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

fn product(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

/// SSIM's window over a plane, only where it fits inside; smaller planes are averaged.
struct Blur {
    width: usize,
    height: usize,
}

impl Blur {
    fn apply(&self, plane: &[f32]) -> Vec<f32> {
        if self.width < TAPS || self.height < TAPS {
            return vec![plane.iter().sum::<f32>() / plane.len() as f32];
        }
        let taps = taps();
        let (out_width, out_height) = (self.width - TAPS + 1, self.height - TAPS + 1);
        let mut narrow = vec![0.0; out_width * self.height];
        for (row, out) in plane.chunks_exact(self.width).zip(narrow.chunks_exact_mut(out_width)) {
            for (offset, tap) in taps.into_iter().enumerate() {
                out.iter_mut().zip(&row[offset..]).for_each(|(sum, v)| *sum += tap * v);
            }
        }
        let mut result = vec![0.0; out_width * out_height];
        for (y, out) in result.chunks_exact_mut(out_width).enumerate() {
            for (offset, tap) in taps.into_iter().enumerate() {
                let row = &narrow[(y + offset) * out_width..][..out_width];
                out.iter_mut().zip(row).for_each(|(sum, v)| *sum += tap * v);
            }
        }
        result
    }
}

fn taps() -> [f32; TAPS] {
    let weight = |i: usize| (-(i as f32 - (TAPS / 2) as f32).powi(2) / (2.0 * 1.5 * 1.5)).exp();
    let total: f32 = (0..TAPS).map(weight).sum();
    std::array::from_fn(|i| weight(i) / total)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth coloured scene, dark towards one side, with some structure.
    fn scene(width: usize, height: usize, phase: f32) -> Image<Srgb> {
        let mut image = Image::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f32 / width as f32, y as f32 / height as f32);
                let light =
                    (0.02 + 0.3 * u * u) * (1.0 + 0.6 * (23.0 * u + 11.0 * v + phase).sin());
                image.set(x, y, [light, light * (0.5 + 0.4 * v), light * (0.9 - 0.5 * u)]);
            }
        }
        image
    }

    /// The mean distance between two curves over the colours of an image.
    fn distance(image: &Image<Srgb>, a: &ToneCurve, b: &ToneCurve) -> f32 {
        let (a, b) = (a.apply(image), b.apply(image));
        a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).sum::<f32>()
            / a.data().len() as f32
    }

    #[test]
    fn a_known_anchor_is_recovered_and_a_wrong_one_noticed() {
        let views: Vec<_> = [0.0, 1.0, 2.5].map(|phase| scene(200, 120, phase)).into();
        let histogram = Histogram::pooled(&views);
        let equalised = [(0.8, 0.9), (3.0, 0.6), (8.0, 0.45), (0.3, 0.35)]
            .map(|(alpha, gamma)| Anchor::Equalised { alpha, gamma });
        let exposures = [(0.5, 0.0), (1.9, 0.01), (3.0, -0.02)]
            .map(|(ev, black)| Anchor::Exposure { ev, black });
        for known in equalised.into_iter().chain(exposures) {
            let truth = ToneCurve::new(&histogram, known);
            let targets: Vec<_> = views.iter().map(|view| truth.apply(view)).collect();
            let pairs: Vec<_> = views.iter().zip(&targets).collect();
            let found = match_anchor(&pairs, &histogram, known, 7);
            let off = distance(&views[1], &truth, &ToneCurve::new(&histogram, found.anchor));
            assert!(off < 0.01, "{known:?}: {found:?} is off by {off}");
            let wrong = match known {
                Anchor::Equalised { alpha, gamma } => {
                    Anchor::Equalised { alpha, gamma: if gamma > 0.65 { MIN_GAMMA } else { 1.0 } }
                }
                Anchor::Exposure { ev, black } => Anchor::Exposure { ev: ev + 1.0, black },
            };
            let wrong = ToneCurve::new(&histogram, wrong);
            assert!(distance(&views[1], &truth, &wrong) > 0.05, "{known:?}");
        }
    }

    #[test]
    fn equal_seeds_find_equal_anchors() {
        let view = scene(160, 90, 0.0);
        let histogram = Histogram::of(&view);
        let known = Anchor::exposure(1.3);
        let target = ToneCurve::new(&histogram, known).apply(&view);
        let run = |seed| match_anchor(&[(&view, &target)], &histogram, known, seed);
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
    }

    #[test]
    fn black_and_tiny_images_are_matched() {
        for (width, height) in [(1, 1), (5, 40), (64, 64)] {
            let black = Image::new(width, height);
            let found =
                match_anchor(&[(&black, &black)], &Histogram::of(&black), Anchor::exposure(1.0), 1);
            assert!(found.cost.is_finite(), "{width}x{height}: {found:?}");
        }
    }

    #[test]
    fn the_fast_curve_matches_the_curve() {
        let view = scene(64, 64, 0.3);
        for anchor in [
            Anchor::Equalised { alpha: 10.0, gamma: 0.3 },
            Anchor::Equalised { alpha: 0.0, gamma: 0.5 },
            Anchor::exposure(2.5),
        ] {
            let curve = ToneCurve::new(&Histogram::of(&view), anchor);
            let fast = FastCurve::new(&curve);
            for i in 0..64 {
                let rgb = view.get(i, i);
                let (a, b) = (curve.apply_colour(rgb), fast.apply(rgb));
                assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn views_are_spread_over_the_capture() {
        assert_eq!(spread_indices(20, 5), [0, 4, 9, 14, 19]);
        assert_eq!(spread_indices(3, 5), [0, 1, 2]);
        assert_eq!(spread_indices(9, 1), [4]);
        assert!(spread_indices(0, 5).is_empty());
    }
}
