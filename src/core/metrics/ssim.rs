//! Structural similarity as in published tables.

use rayon::prelude::*;

use crate::image::Image;

/// Taps on each side of the window's centre: 11 x 11 px in total.
const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;
const SIGMA: f64 = 1.5;
/// `(0.01 L)^2` and `(0.03 L)^2` with L = 1, from Wang et al. 2004.
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// Mean structural similarity over the three channels and the valid region (no padding): Gaussian
/// window of 11 x 11 px, sigma 1.5, population covariance, data range 1. Equals scikit-image's
/// `structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
/// data_range=1)` on that region. Only the image is clipped to 0..=1, not the reference.
///
/// # Panics
/// When the sizes differ or an image is smaller than the window: a fault of the caller.
pub fn ssim(image: &Image, reference: &Image) -> f64 {
    ssim_where(image, reference, |_, _| true).unwrap_or(1.0)
}

/// [`ssim`] over the windows whose middle pixel, at x and y, counts; `None` without any.
///
/// # Panics
/// As [`ssim`].
pub fn ssim_where(
    image: &Image,
    reference: &Image,
    counts: impl Fn(usize, usize) -> bool + Sync,
) -> Option<f64> {
    super::assert_same_size(image, reference);
    let (width, height) = (image.width(), image.height());
    assert!(
        width >= TAPS && height >= TAPS,
        "SSIM needs at least {TAPS} x {TAPS} px, not {width}x{height}"
    );
    let windows = (RADIUS..height - RADIUS)
        .map(|y| (RADIUS..width - RADIUS).filter(|&x| counts(x, y)).count())
        .sum::<usize>();
    let sums: Vec<f64> = (0..3)
        .into_par_iter()
        .map(|c| plane_sum(image.plane(c), reference.plane(c), width, &counts))
        .map(|sum| sum / windows as f64)
        .collect();
    (windows > 0).then(|| sums.iter().sum::<f64>() / 3.0)
}

/// Sum over the windows of one channel that count.
fn plane_sum(
    image: &[f32],
    reference: &[f32],
    width: usize,
    counts: &(impl Fn(usize, usize) -> bool + Sync),
) -> f64 {
    let height = image.len() / width;
    let valid_width = width - TAPS + 1;
    let weights = window();
    let rows: Vec<[Vec<f64>; 5]> = (0..height)
        .into_par_iter()
        .map(|y| {
            let row = y * width..(y + 1) * width;
            row_moments(&image[row.clone()], &reference[row], &weights)
        })
        .collect();
    let valid_rows = height - TAPS + 1;
    let sums: Vec<f64> = (0..valid_rows)
        .into_par_iter()
        .map(|y| {
            let moments: [Vec<f64>; 5] =
                std::array::from_fn(|n| filtered(&weights, valid_width, |tap| &rows[y + tap][n]));
            (0..valid_width)
                .filter(|x| counts(x + RADIUS, y + RADIUS))
                .map(|x| similarity(std::array::from_fn(|n| moments[n][x])))
                .sum::<f64>()
        })
        .collect();
    sums.iter().sum::<f64>()
}

/// Horizontally filtered x, y, x^2, y^2 and x y of one row's valid part.
fn row_moments(image: &[f32], reference: &[f32], weights: &[f64; TAPS]) -> [Vec<f64>; 5] {
    let valid = image.len() - TAPS + 1;
    let x: Vec<f64> = image.iter().map(|&value| f64::from(value).clamp(0.0, 1.0)).collect();
    let y: Vec<f64> = reference.iter().map(|&value| f64::from(value)).collect();
    let product =
        |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let (xx, yy, xy) = (product(&x, &x), product(&y, &y), product(&x, &y));
    [x, y, xx, yy, xy].map(|values| filtered(weights, valid, |tap| &values[tap..]))
}

/// The weighted sums of `count` numbers; `at` returns those of a tap. A loop over numbers, not
/// taps, inside: processors take several of them at once.
fn filtered<'a>(weights: &[f64; TAPS], count: usize, at: impl Fn(usize) -> &'a [f64]) -> Vec<f64> {
    let mut sums = vec![0.0; count];
    for (tap, weight) in weights.iter().enumerate() {
        for (sum, value) in sums.iter_mut().zip(at(tap)) {
            *sum += weight * value;
        }
    }
    sums
}

fn similarity([x, y, xx, yy, xy]: [f64; 5]) -> f64 {
    let luminance = (2.0 * x * y + C1) / (x * x + y * y + C1);
    let structure = (2.0 * (xy - x * y) + C2) / ((xx - x * x) + (yy - y * y) + C2);
    luminance * structure
}

/// The normalised Gaussian taps.
fn window() -> [f64; TAPS] {
    let mut weights = [0.0; TAPS];
    for (tap, weight) in weights.iter_mut().enumerate() {
        let offset = tap as f64 - RADIUS as f64;
        *weight = (-offset * offset / (2.0 * SIGMA * SIGMA)).exp();
    }
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(phase: f32) -> Image {
        let (width, height) = (23, 17);
        let values =
            (0..3 * width * height).map(|i| 0.5 + 0.4 * (i as f32 * 0.7 + phase).sin()).collect();
        Image::from_planar(width, height, values)
    }

    #[test]
    fn an_image_is_most_similar_to_itself() {
        assert!((ssim(&texture(0.0), &texture(0.0)) - 1.0).abs() < 1e-12);
        assert!(ssim(&texture(0.0), &texture(1.5)) < 0.5);
    }

    #[test]
    fn a_middle_pixel_counts_more_than_a_border_pixel() {
        let reference = texture(0.0);
        let (mut corner, mut middle) = (reference.clone(), reference.clone());
        corner.set(0, 0, [0.0; 3]);
        middle.set(11, 8, [0.0; 3]);
        let (corner, middle) = (ssim(&corner, &reference), ssim(&middle, &reference));
        assert!(middle < corner && corner < 1.0, "{middle} {corner}");
    }

    #[test]
    #[should_panic(expected = "at least 11 x 11")]
    fn an_image_smaller_than_the_window_is_refused() {
        let small = Image::new(10, 40);
        ssim(&small, &small);
    }

    #[test]
    #[should_panic(expected = "sizes differ")]
    fn images_of_different_sizes_are_refused() {
        ssim(&Image::new(20, 30), &Image::new(30, 20));
    }
}
