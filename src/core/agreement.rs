//! Agreement of a kernel's results with a reference, for tests.

/// Relative L2 error, cosine and signed bias of `found` against `expected`.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    /// |found - expected| / |expected|.
    pub relative: f64,
    /// Cosine of the angle between the two.
    pub cosine: f64,
    /// Sum of the differences over the sum of the expected magnitudes.
    pub bias: f64,
}

/// Compares two gradients or images of the same length.
pub fn agreement(found: &[f32], expected: &[f64]) -> Agreement {
    assert_eq!(found.len(), expected.len(), "lengths");
    let (mut error, mut dot, mut found_square, mut square, mut bias, mut sum) =
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (&f, &e) in found.iter().zip(expected) {
        let f = f64::from(f);
        error += (f - e).powi(2);
        dot += f * e;
        found_square += f * f;
        square += e * e;
        bias += f - e;
        sum += e.abs();
    }
    Agreement {
        relative: (error / square).sqrt(),
        cosine: dot / (found_square * square).sqrt(),
        bias: bias / sum,
    }
}

impl Agreement {
    /// Whether relative error and bias are within the tolerance and the cosine is at least 0.9999.
    /// Never true with values that are not finite.
    pub fn within(&self, tolerance: f64) -> bool {
        self.relative <= tolerance && self.bias.abs() <= tolerance && self.cosine >= 0.9999
    }
}

/// Panics with the statistics unless `found` agrees with `expected` to the tolerance.
#[track_caller]
pub fn assert_agrees(what: &str, found: &[f32], expected: &[f64], tolerance: f64) {
    let agreement = agreement(found, expected);
    assert!(agreement.within(tolerance), "{what}: {agreement:?}, tolerance {tolerance:e}");
}

/// Panics unless the analytic derivative equals the central difference of `f` around `at`.
#[track_caller]
pub fn assert_derivative(what: &str, analytic: f64, at: f64, mut f: impl FnMut(f64) -> f64) {
    let step = 1e-5 * at.abs().max(1.0);
    let numeric = (f(at + step) - f(at - step)) / (2.0 * step);
    let error = (analytic - numeric).abs();
    assert!(
        error <= 1e-5 * numeric.abs() + 1e-9,
        "{what}: {analytic:e} against {numeric:e} by differences"
    );
}

mod tests {
    use super::*;

    #[test]
    fn equal_values_agree_and_every_kind_of_error_is_detected() {
        let expected: Vec<f64> = (0..1000).map(|i| (f64::from(i) * 0.37).sin()).collect();
        let with = |f: &dyn Fn(usize, f64) -> f64| -> bool {
            let found: Vec<f32> =
                expected.iter().enumerate().map(|(i, &e)| f(i, e) as f32).collect();
            agreement(&found, &expected).within(1e-3)
        };
        assert!(with(&|_, e| e));
        assert!(!with(&|_, e| 1.01 * e), "scale");
        assert!(!with(&|_, e| e + 2e-3), "offset");
        assert!(!with(&|_, e| -e), "sign");
        assert!(!with(&|i, e| if i == 500 { e + 0.2 } else { e }), "outlier");
        assert!(!with(&|i, e| if i == 3 { f64::NAN } else { e }), "not a number");
    }

    #[test]
    #[should_panic(expected = "tolerance")]
    fn a_wrong_gradient_panics() {
        assert_agrees("wrong", &[1.0, 2.0], &[1.0, 2.1], 1e-3);
    }

    #[test]
    #[should_panic(expected = "by differences")]
    fn a_wrong_derivative_panics() {
        assert_derivative("square", 2.1, 1.0, |x| x * x);
    }
}
