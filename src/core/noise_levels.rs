//! The noise of an image by its brightness.

use crate::image::Image;

/// Levels of brightness: equal parts of 0..=1, each with its own noise, because brightening makes
/// dark parts the noisiest.
pub const LEVELS: usize = 16;
/// Minimum number of differences that determine the noise of a level; with fewer, that of the whole
/// image is used.
const MIN_DIFFERENCES: usize = 2_000;
/// Minimum deviation: images that do not differ divide by it.
const MIN_DEVIATION: f32 = 1e-4;
/// The median of the absolute values of Gaussian noise, relative to its standard deviation.
const MEDIAN: f32 = 0.6745;

/// Standard deviation of an image's noise at each of the [`LEVELS`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLevels(pub [f32; LEVELS]);

impl NoiseLevels {
    /// The noise of an image, from the same image without noise.
    pub fn between(image: &Image, clean: &Image) -> Self {
        let values = image.data().iter().zip(clean.data());
        let residual: Vec<f32> = values.map(|(image, clean)| image - clean).collect();
        Self::of_residual(&residual, clean)
    }

    /// The noise in `residual`, planar, by the level of `clean`, the image without it. A diagonal
    /// difference of neighbours has the variance of white noise and little of edges; the median
    /// ignores the edges.
    pub fn of_residual(residual: &[f32], clean: &Image) -> Self {
        let (width, height) = (clean.width(), clean.height());
        let mut levels: [Vec<f32>; LEVELS] = Default::default();
        for (channel, residual) in residual.chunks_exact(width * height).enumerate() {
            let clean = clean.plane(channel);
            for row in 0..height - 1 {
                for at in row * width..(row + 1) * width - 1 {
                    let below = at + width;
                    let difference = 0.5
                        * (residual[at] - residual[at + 1] - residual[below] + residual[below + 1]);
                    levels[level(clean[at])].push(difference.abs());
                }
            }
        }
        let whole = deviation(levels.concat());
        Self(levels.map(
            |values| {
                if values.len() < MIN_DIFFERENCES { whole } else { deviation(values) }
            },
        ))
    }

    /// The mean deviation over an image's values.
    pub fn mean_over(&self, image: &Image) -> f64 {
        self.0
            .iter()
            .zip(shares(image))
            .map(|(deviation, share)| f64::from(deviation * share))
            .sum()
    }

    /// The deviation at the level of a value.
    pub fn at(&self, value: f32) -> f32 {
        self.0[level(value)]
    }
}

/// Share of an image's values at each of the [`LEVELS`].
fn shares(image: &Image) -> [f32; LEVELS] {
    let mut counts = [0_u32; LEVELS];
    for value in image.data() {
        counts[level(*value)] += 1;
    }
    counts.map(|count| count as f32 / image.data().len().max(1) as f32)
}

fn level(value: f32) -> usize {
    ((value.max(0.0) * LEVELS as f32) as usize).min(LEVELS - 1)
}

fn deviation(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return MIN_DEVIATION;
    }
    let middle = values.len() / 2;
    let (_, median, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    (*median / MEDIAN).max(MIN_DEVIATION)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Discs of many grey levels, sharp and without noise.
    fn discs() -> Image {
        let mut image = Image::new(240, 200);
        for (x, y) in (0..240 * 200).map(|i| (i % 240, i / 240)) {
            let (u, v) = ((x % 24) as f64 - 12.0, (y % 20) as f64 - 10.0);
            let grey = ((x / 24 + 3 * (y / 20)) % 16) as f32 / 16.0 + 0.03;
            let is_inside = u.hypot(v) < 8.0;
            image.set(x, y, [if is_inside { grey } else { 1.0 - grey }; 3]);
        }
        image
    }

    fn noisy(clean: &Image, deviation: impl Fn(f32) -> f32) -> Image {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let mut normal = || (0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0;
        let mut image = clean.clone();
        image.data_mut().iter_mut().for_each(|value| *value += deviation(*value) * normal());
        image
    }

    #[test]
    fn the_noise_of_each_level_is_found() {
        let clean = discs();
        let deviation = |value: f32| 0.02 / (value + 0.1);
        let found = NoiseLevels::between(&noisy(&clean, deviation), &clean);
        for value in [0.03, 0.28, 0.53, 0.97] {
            let ratio = found.at(value) / deviation(value);
            assert!((ratio - 1.0).abs() < 0.2, "{value}: {ratio}");
        }
        let mean = found.mean_over(&clean);
        assert!(mean > 0.02 / 1.1 && mean < 0.2, "{mean}");
    }

    #[test]
    fn edges_that_the_clean_image_lacks_are_hardly_noise() {
        let clean = discs();
        let mut soft = clean.clone();
        for x in 1..clean.width() {
            for y in 0..clean.height() {
                let (a, b) = (clean.get(x - 1, y)[0], clean.get(x, y)[0]);
                soft.set(x, y, [0.5 * (a + b); 3]);
            }
        }
        let found = NoiseLevels::between(&noisy(&clean, |_| 0.03), &soft);
        assert!(found.0.iter().all(|d| (0.02..0.05).contains(d)), "{found:?}");
    }

    #[test]
    fn an_image_without_noise_has_nearly_none() {
        let found = NoiseLevels::between(&discs(), &discs());
        assert_eq!(found.0, [MIN_DEVIATION; LEVELS]);
    }

    #[test]
    fn shares_add_up_to_one() {
        let mut image = Image::new(2, 1);
        image.set(0, 0, [-0.2, 0.0, 1.7]);
        image.set(1, 0, [0.5, 0.5, 0.5]);
        let shares = shares(&image);
        assert!((shares[0] - 2.0 / 6.0).abs() < 1e-6 && (shares[8] - 0.5).abs() < 1e-6);
        assert!((shares.iter().sum::<f32>() - 1.0).abs() < 1e-6);
    }
}
