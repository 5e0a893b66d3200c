//! The reference of the training loss, in plain `f64`.

use super::{L1_SHARE, SSIM_SHARE};

const RADIUS: isize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// The noise of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceNoise {
    /// Its standard deviation at the middles of 16 equal parts of 0..=1; linear between them.
    pub deviations: [f64; 16],
}

impl ReferenceNoise {
    /// No noise.
    pub const NONE: Self = Self { deviations: [0.0; 16] };

    fn at(&self, value: f64) -> f64 {
        let place = (value * 16.0 - 0.5).clamp(0.0, 15.0);
        let below = (place as usize).min(14);
        let [low, high] = [self.deviations[below], self.deviations[below + 1]];
        low + (place - below as f64) * (high - low)
    }
}

/// Loss of a planar image [3, height, width], its parts, and its gradient by the prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceLoss {
    /// Mean absolute error.
    pub l1: f64,
    /// Mean squared error.
    pub squared: f64,
    /// Mean structural similarity, zero-padded.
    pub ssim: f64,
    /// Derivative of the loss by every value of the prediction, [3, height, width].
    pub gradient: Vec<f64>,
}

impl ReferenceLoss {
    /// `0.8 l1 + 0.2 (1 - ssim)`.
    pub fn total(&self) -> f64 {
        L1_SHARE * self.l1 + SSIM_SHARE * (1.0 - self.ssim)
    }
}

/// The loss of a prediction against a target, both planar [3, height, width].
pub fn loss(
    prediction: &[f64],
    target: &[f64],
    noise: &ReferenceNoise,
    width: usize,
) -> ReferenceLoss {
    let plane = prediction.len() / 3;
    let mut result = ReferenceLoss { l1: 0.0, squared: 0.0, ssim: 0.0, gradient: Vec::new() };
    for channel in 0..3 {
        let range = channel * plane..(channel + 1) * plane;
        add_plane(&mut result, [&prediction[range.clone()], &target[range]], noise, width);
    }
    let n = prediction.len() as f64;
    result.l1 /= n;
    result.squared /= n;
    result.ssim /= n;
    for gradient in &mut result.gradient {
        *gradient /= n;
    }
    result
}

/// [`loss`] without the pixels, row by row, that are not `kept`: there the prediction is taken to
/// be the target, and its gradient is 0.
pub fn masked_loss(
    prediction: &[f64],
    (target, kept): (&[f64], &[bool]),
    noise: &ReferenceNoise,
    width: usize,
) -> ReferenceLoss {
    let pixels = prediction.iter().zip(target).zip(kept.iter().cycle());
    let filled: Vec<f64> = pixels.map(|((p, t), kept)| if *kept { *p } else { *t }).collect();
    let mut result = loss(&filled, target, noise, width);
    let gradients = result.gradient.iter_mut().zip(kept.iter().cycle());
    gradients.filter(|(_, kept)| !**kept).for_each(|(gradient, _)| *gradient = 0.0);
    result
}

/// Adds the sums and appends the gradient of one channel, not yet divided by the number of values.
fn add_plane(
    result: &mut ReferenceLoss,
    [x, y]: [&[f64]; 2],
    noise: &ReferenceNoise,
    width: usize,
) {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
    let means = [x.to_vec(), y.to_vec(), product(x, x), product(y, y), product(x, y)]
        .map(|f| blur(&f, width));
    let mut derivatives = [vec![0.0; x.len()], vec![0.0; x.len()], vec![0.0; x.len()]];
    for i in 0..x.len() {
        let means = [0, 1, 2, 3, 4].map(|k: usize| means[k][i]);
        let (similarity, by) = similarity(means, noise.at(means[1]));
        result.ssim += similarity;
        for (derivative, value) in derivatives.iter_mut().zip(by) {
            derivative[i] = value;
        }
    }
    // The window is symmetric, so its transpose is the window itself.
    let [by_mean, by_square, by_product] = derivatives.map(|d| blur(&d, width));
    for i in 0..x.len() {
        let error = x[i] - y[i];
        result.l1 += error.abs();
        result.squared += error * error;
        let sign = if error == 0.0 { 0.0 } else { error.signum() };
        let similarity = by_mean[i] + 2.0 * x[i] * by_square[i] + y[i] * by_product[i];
        result.gradient.push(L1_SHARE * sign - SSIM_SHARE * similarity);
    }
}

/// SSIM from the window's means of x, y, x^2, y^2 and x y, and its derivatives by those of x, x^2
/// and x y. Noise of this deviation, which no render shares, counts as little as C2 does.
fn similarity([mx, my, mxx, myy, mxy]: [f64; 5], deviation: f64) -> (f64, [f64; 3]) {
    let c2 = C2 + 2.0 * deviation * deviation;
    let (a1, a2) = (2.0 * mx * my + C1, 2.0 * (mxy - mx * my) + c2);
    let (b1, b2) = (mx * mx + my * my + C1, mxx - mx * mx + myy - my * my + c2);
    let s = a1 * a2 / (b1 * b2);
    let by_mean = 2.0 * my * (a2 - a1) / (b1 * b2) + 2.0 * mx * s * (1.0 / b2 - 1.0 / b1);
    (s, [by_mean, -s / b2, 2.0 * a1 / (b1 * b2)])
}

/// Convolution with the normalised Gaussian of 11 x 11 px; zero outside the image.
fn blur(plane: &[f64], width: usize) -> Vec<f64> {
    let height = plane.len() / width;
    let weight = |offset: isize| (-(offset * offset) as f64 / (2.0 * SIGMA * SIGMA)).exp();
    let total: f64 = (-RADIUS..=RADIUS).map(weight).sum();
    let along = |input: &[f64], step: (isize, isize)| -> Vec<f64> {
        let at = |x: isize, y: isize| {
            let inside = (0..width as isize).contains(&x) && (0..height as isize).contains(&y);
            if inside { input[y as usize * width + x as usize] } else { 0.0 }
        };
        let value = |i: usize| {
            let (x, y) = ((i % width) as isize, (i / width) as isize);
            (-RADIUS..=RADIUS).map(|k| weight(k) / total * at(x + k * step.0, y + k * step.1)).sum()
        };
        (0..input.len()).map(value).collect()
    };
    along(&along(plane, (1, 0)), (0, 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agreement::assert_derivative;

    const WIDTH: usize = 13;
    const HEIGHT: usize = 9;

    /// Strong in the dark.
    const NOISE: ReferenceNoise = ReferenceNoise {
        deviations: [
            0.3, 0.21, 0.15, 0.11, 0.08, 0.06, 0.05, 0.04, 0.03, 0.02, 0.01, 0.008, 0.004, 0.002,
            0.001, 0.0,
        ],
    };

    fn waves(frequency: f64) -> Vec<f64> {
        (0..3 * WIDTH * HEIGHT).map(|i| 0.5 + 0.45 * (frequency * (i as f64 + 1.0)).sin()).collect()
    }

    #[test]
    fn the_gradient_matches_central_differences() {
        let (mut prediction, target) = (waves(0.71), waves(0.53));
        for noise in [ReferenceNoise::NONE, NOISE] {
            let gradient = loss(&prediction, &target, &noise, WIDTH).gradient;
            for i in (0..prediction.len()).step_by(7) {
                let at = prediction[i];
                // The kink of |p - t| has no derivative.
                assert!((at - target[i]).abs() > 1e-4);
                assert_derivative(&format!("value {i}"), gradient[i], at, |value| {
                    prediction[i] = value;
                    loss(&prediction, &target, &noise, WIDTH).total()
                });
                prediction[i] = at;
            }
        }
    }

    #[test]
    fn the_masked_gradient_matches_central_differences() {
        let (mut prediction, target) = (waves(0.71), waves(0.53));
        let kept: Vec<bool> = (0..WIDTH * HEIGHT).map(|i| i % WIDTH > 4 && i % 7 != 0).collect();
        let gradient = masked_loss(&prediction, (&target, &kept), &NOISE, WIDTH).gradient;
        for i in (0..prediction.len()).step_by(5) {
            let at = prediction[i];
            assert_derivative(&format!("value {i}"), gradient[i], at, |value| {
                prediction[i] = value;
                masked_loss(&prediction, (&target, &kept), &NOISE, WIDTH).total()
            });
            prediction[i] = at;
            assert_eq!(gradient[i] == 0.0, !kept[i % (WIDTH * HEIGHT)], "value {i}");
        }
    }

    #[test]
    fn masked_pixels_do_not_affect_the_loss() {
        let (prediction, target) = (waves(0.71), waves(0.53));
        let kept: Vec<bool> = (0..WIDTH * HEIGHT).map(|i| i % WIDTH > 4).collect();
        let other = prediction.iter().zip(kept.iter().cycle());
        let other: Vec<f64> = other.map(|(p, kept)| if *kept { *p } else { 1.0 - p }).collect();
        let of = |kept: &[bool], prediction: &[f64]| {
            masked_loss(prediction, (&target, kept), &NOISE, WIDTH)
        };
        assert_eq!(of(&kept, &prediction), of(&kept, &other));
        let nothing = of(&[false; WIDTH * HEIGHT], &prediction);
        assert!(nothing.total().abs() < 1e-12);
    }

    #[test]
    fn the_target_itself_has_zero_loss() {
        let target = waves(0.53);
        for noise in [ReferenceNoise::NONE, NOISE] {
            let result = loss(&target, &target, &noise, WIDTH);
            assert!(result.total().abs() < 1e-12);
            assert!(result.gradient.iter().all(|g| g.abs() < 1e-9));
        }
    }

    #[test]
    fn differences_in_noise_matter_less_than_in_clean_values() {
        let (target, mut prediction) = (waves(0.53), waves(0.53));
        for (at, value) in prediction.iter_mut().enumerate() {
            *value += if at % 2 == 0 { 0.05 } else { -0.05 };
        }
        let [clean, noisy] = [ReferenceNoise::NONE, NOISE]
            .map(|noise| 1.0 - loss(&prediction, &target, &noise, WIDTH).ssim);
        assert!(noisy < 0.95 * clean, "{noisy} {clean}");
    }

    #[test]
    fn noise_is_linear_between_levels_and_constant_beyond() {
        let at = [0.0, 1.5 / 16.0, 1.0 / 8.0, 1.0].map(|value| NOISE.at(value));
        let apart = |(found, wanted): (f64, f64)| (found - wanted).abs();
        assert!(at.into_iter().zip([0.3, 0.21, 0.18, 0.0]).map(apart).all(|a| a < 1e-12), "{at:?}");
    }
}
