//! Metrics of a single image: noise, sharpness, brightness, clipping.

use crate::image::Image;

/// Luma weights of Rec. 601, on sRGB-encoded values.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Value from which a channel becomes 255 in eight bits.
const WHITE: f32 = 254.5 / 255.0;

/// Standard deviation of the noise on luma, 0..=1, after Immerkaer 1996: the mean absolute response
/// of a mask that ignores planes and straight edges. Texture adds to it; clipped and smoothed noise
/// escapes it.
///
/// # Panics
/// When the image is smaller than 3 x 3 px: a fault of the caller.
pub fn noise_sigma(image: &Image) -> f64 {
    let luma = Luma::new(image);
    let sum: f64 =
        luma.responses([1.0, -2.0, 1.0, -2.0, 4.0, -2.0, 1.0, -2.0, 1.0]).map(f64::abs).sum();
    (std::f64::consts::PI / 2.0).sqrt() * sum / (6.0 * luma.inner() as f64)
}

/// `255^2 max(0, var(Laplacian) - 20 sigma^2)` on luma: the variance of the Laplacian, which counts
/// noise as sharpness, minus the contribution of noise of [`noise_sigma`] (20 is the sum of the
/// squared weights of the 4-neighbour mask).
///
/// # Panics
/// When the image is smaller than 3 x 3 px.
pub fn sharpness(image: &Image) -> f64 {
    let luma = Luma::new(image);
    let responses: Vec<f64> =
        luma.responses([0.0, 1.0, 0.0, 1.0, -4.0, 1.0, 0.0, 1.0, 0.0]).collect();
    let n = responses.len() as f64;
    let mean = responses.iter().sum::<f64>() / n;
    let variance = responses.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n;
    let sigma = noise_sigma(image);
    255.0 * 255.0 * (variance - 20.0 * sigma * sigma).max(0.0)
}

/// Mean over the pixels of HSV's V, the largest channel, clipped to 0..=1.
pub fn mean_v(image: &Image) -> f64 {
    values(image).map(|v| f64::from(v.clamp(0.0, 1.0))).sum::<f64>() / image.pixels().max(1) as f64
}

/// Share of the pixels with a channel that is white in eight bits, 0..=1: clipped by brightening.
pub fn clipped_share(image: &Image) -> f64 {
    values(image).filter(|&v| v >= WHITE).count() as f64 / image.pixels().max(1) as f64
}

/// HSV's V of every pixel.
fn values(image: &Image) -> impl Iterator<Item = f32> + '_ {
    let [r, g, b] = [image.plane(0), image.plane(1), image.plane(2)];
    r.iter().zip(g).zip(b).map(|((&r, &g), &b)| r.max(g).max(b))
}

struct Luma {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

impl Luma {
    fn new(image: &Image) -> Self {
        let (width, height) = (image.width(), image.height());
        assert!(
            width >= 3 && height >= 3,
            "a 3 x 3 mask needs at least 3 x 3 px, not {width}x{height}"
        );
        let mut values = vec![0.0; image.pixels()];
        for (channel, weight) in LUMA.into_iter().enumerate() {
            for (value, &x) in values.iter_mut().zip(image.plane(channel)) {
                *value += f64::from(weight) * f64::from(x);
            }
        }
        Self { width, height, values }
    }

    /// Number of pixels with all eight neighbours.
    fn inner(&self) -> usize {
        (self.width - 2) * (self.height - 2)
    }

    /// The response of a row-major 3 x 3 mask at every inner pixel.
    fn responses(&self, mask: [f64; 9]) -> impl Iterator<Item = f64> + '_ {
        (1..self.height - 1).flat_map(move |y| {
            (1..self.width - 1).map(move |x| {
                let corner = (y - 1) * self.width + x - 1;
                (0..9).map(|i| mask[i] * self.values[corner + i / 3 * self.width + i % 3]).sum()
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn noisy(sigma: f32, seed: u64) -> Image {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        // The sum of twelve uniform numbers has variance 1 and is close enough to normal here.
        let mut normal = || (0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0;
        let (width, height) = (160, 120);
        let mut image = Image::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let value = 0.3 + 0.001 * x as f32 + 0.002 * y as f32 + sigma * normal();
                image.set(x, y, [value; 3]);
            }
        }
        image
    }

    fn stripes(contrast: f32) -> Image {
        let mut image = Image::new(160, 120);
        for y in 0..120 {
            for x in 0..160 {
                let value = if x / 20 % 2 == 0 { 0.5 - contrast } else { 0.5 + contrast };
                image.set(x, y, [value; 3]);
            }
        }
        image
    }

    #[test]
    fn the_added_noise_of_a_ramp_is_measured() {
        for sigma in [0.01, 0.05] {
            let found = noise_sigma(&noisy(sigma, 1));
            assert!((found / f64::from(sigma) - 1.0).abs() < 0.03, "{sigma} {found}");
        }
        assert!(noise_sigma(&noisy(0.0, 1)) < 1e-6);
    }

    #[test]
    fn edges_are_sharp_and_noise_is_not() {
        let (edges, noise) = (sharpness(&stripes(0.3)), sharpness(&noisy(0.05, 2)));
        assert!(edges > 1000.0, "{edges}");
        assert!(noise < 0.03 * 20.0 * (0.05 * 255.0_f64).powi(2) + 50.0, "{noise}");
        assert!(sharpness(&stripes(0.1)) < edges);
    }

    #[test]
    fn brightness_uses_the_largest_channel_and_clipping_any() {
        let mut image = Image::new(4, 1);
        image.set(0, 0, [0.2, 0.4, 0.1]);
        image.set(1, 0, [1.0, 0.0, 0.0]);
        image.set(2, 0, [1.4, 0.3, 0.3]);
        assert!((mean_v(&image) - 2.4 / 4.0).abs() < 1e-7);
        assert!((clipped_share(&image) - 0.5).abs() < 1e-12);
    }
}
