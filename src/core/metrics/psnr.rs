//! Peak signal-to-noise ratio, raw and after a per-channel affine colour fit.

use crate::image::Image;

/// Floor of the squared error: equal images have no finite PSNR, so the value is limited to 100 dB
/// and stays a JSON number.
const LEAST_SQUARED_ERROR: f64 = 1e-10;

/// `-10 log10(mean((clip(image) - reference)^2))` over all pixels and channels, dB, at most 100.
///
/// # Panics
/// When the sizes differ: a fault of the caller.
pub fn psnr(image: &Image, reference: &Image) -> f64 {
    super::assert_same_size(image, reference);
    let sum: f64 = (0..3).map(|c| squared_error(image.plane(c), reference.plane(c), |x| x)).sum();
    decibels(sum / (3 * image.pixels()) as f64)
}

/// [`psnr`] after the least-squares fit `a * clip(image) + b` of each channel to the reference,
/// clipped again, which forgives a global colour cast and exposure error. dB.
///
/// # Panics
/// When the sizes differ.
pub fn psnr_colour_corrected(image: &Image, reference: &Image) -> f64 {
    super::assert_same_size(image, reference);
    let fit = ColourFit::between(image, reference);
    let sum: f64 = (0..3)
        .map(|c| {
            let (x, y) = (image.plane(c), reference.plane(c));
            squared_error(x, y, |v| fit.value(c, v))
        })
        .sum();
    decibels(sum / (3 * image.pixels()) as f64)
}

/// The least-squares affine map of each channel of one image to that of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourFit {
    /// Factor and offset per channel.
    channels: [(f64, f64); 3],
}

impl ColourFit {
    /// Fits `a * clip(image) + b` to the reference.
    ///
    /// # Panics
    /// When the sizes differ: a fault of the caller.
    pub fn between(image: &Image, reference: &Image) -> Self {
        super::assert_same_size(image, reference);
        Self { channels: std::array::from_fn(|c| affine_fit(image.plane(c), reference.plane(c))) }
    }

    /// Maps an image, with clipping before and after.
    #[must_use]
    pub fn apply(&self, image: &Image) -> Image {
        let mut mapped = image.clone();
        for c in 0..3 {
            let values = mapped.plane_mut(c).iter_mut();
            values.for_each(|v| *v = self.value(c, clipped(*v)) as f32);
        }
        mapped
    }

    fn value(&self, channel: usize, clipped: f64) -> f64 {
        let (a, b) = self.channels[channel];
        (a * clipped + b).clamp(0.0, 1.0)
    }
}

/// The best PSNR of any clean render against a view with noise of this standard deviation:
/// `-20 log10(sigma)`, dB, at most 100.
pub fn noise_ceiling(sigma: f64) -> f64 {
    decibels(sigma * sigma)
}

/// `-10 log10` of a mean squared error, dB, at most 100.
pub fn decibels(squared_error: f64) -> f64 {
    -10.0 * squared_error.max(LEAST_SQUARED_ERROR).log10()
}

fn clipped(value: f32) -> f64 {
    f64::from(value).clamp(0.0, 1.0)
}

fn squared_error(image: &[f32], reference: &[f32], map: impl Fn(f64) -> f64) -> f64 {
    image.iter().zip(reference).map(|(&x, &y)| (map(clipped(x)) - f64::from(y)).powi(2)).sum()
}

/// The `a` and `b` that minimise `sum (a x + b - y)^2` over clipped `x`; a constant `x` gives
/// `a = 0` and the mean of `y`.
fn affine_fit(image: &[f32], reference: &[f32]) -> (f64, f64) {
    let n = image.len() as f64;
    let mean_x = image.iter().map(|&x| clipped(x)).sum::<f64>() / n;
    let mean_y = reference.iter().map(|&y| f64::from(y)).sum::<f64>() / n;
    let (mut covariance, mut variance) = (0.0, 0.0);
    for (&x, &y) in image.iter().zip(reference) {
        let centred = clipped(x) - mean_x;
        covariance += centred * (f64::from(y) - mean_y);
        variance += centred * centred;
    }
    let a = if variance / n > 1e-12 { covariance / variance } else { 0.0 };
    (a, mean_y - a * mean_x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> Image {
        let values = (0..3 * 12 * 8).map(|i| 0.2 + 0.5 * (i % 96) as f32 / 96.0).collect();
        Image::from_planar(12, 8, values)
    }

    #[test]
    fn equal_images_reach_the_cap_and_an_offset_its_value() {
        let image = ramp();
        assert!((psnr(&image, &image) - 100.0).abs() < 1e-9);
        let brighter = image.map(|v| v + 0.1);
        assert!((psnr(&brighter, &image) - 20.0).abs() < 1e-4);
    }

    #[test]
    fn the_colour_fit_forgives_an_affine_change_and_nothing_else() {
        let image = ramp();
        let graded = image.map(|v| 0.7 * v + 0.1);
        assert!(psnr(&graded, &image) < 30.0);
        assert!(psnr_colour_corrected(&graded, &image) > 80.0);
        let bent = image.map(|v| v * v);
        assert!(psnr_colour_corrected(&bent, &image) < 50.0);
    }

    #[test]
    fn a_constant_image_is_fitted_to_the_mean() {
        let flat = ramp().map(|_| 0.9);
        let fitted = psnr_colour_corrected(&flat, &ramp());
        assert!(fitted.is_finite() && fitted > psnr(&flat, &ramp()));
    }

    #[test]
    fn only_the_image_is_clipped_to_the_range() {
        let white = ramp().map(|_| 1.0);
        assert!((psnr(&white.map(|_| 3.0), &white) - 100.0).abs() < 1e-9);
        assert!(psnr(&white, &white.map(|_| 3.0)) < 0.0);
    }

    #[test]
    fn the_noise_ceiling_of_two_percent_is_34_db() {
        assert!((noise_ceiling(0.02) - 33.979_400_086_720_375).abs() < 1e-9);
        assert!((noise_ceiling(0.0) - 100.0).abs() < 1e-9);
    }
}
