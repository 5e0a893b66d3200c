//! Comparisons of a kernel's results with its reference. Each explains its failure, and is tested
//! to fail.

/// Compares an image with its reference, from which it may jump where a splat is cut off.
///
/// Fails when more than `share` of the values differ by more than `limit`, or any is not finite.
pub fn mostly_within(
    found: &[f32],
    expected: &[f64],
    limit: f64,
    share: f64,
) -> Result<(), String> {
    if found.len() != expected.len() || found.is_empty() {
        return Err(format!("{} values for {}", found.len(), expected.len()));
    }
    let differences = found.iter().zip(expected).map(|(&a, &b)| (f64::from(a) - b).abs());
    let (mut outliers, mut worst) = (0, 0.0_f64);
    for difference in differences {
        if !difference.is_finite() {
            return Err("a value is not finite".to_owned());
        }
        outliers += usize::from(difference > limit);
        worst = worst.max(difference);
    }
    if outliers as f64 > share * found.len() as f64 {
        return Err(format!(
            "{outliers} of {} values beyond {limit}, the worst by {worst}",
            found.len()
        ));
    }
    Ok(())
}

/// Compares gradients with their reference: relative L2 at most 1e-3, cosine at least 0.9999, no
/// signed bias.
pub fn gradients_agree(found: &[f64], expected: &[f64]) -> Result<(), String> {
    if found.len() != expected.len() {
        return Err(format!("{} values for {}", found.len(), expected.len()));
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let norm = dot(expected, expected).sqrt();
    if !norm.is_normal() {
        return Err(format!("the reference has the norm {norm}"));
    }
    let difference: Vec<_> = found.iter().zip(expected).map(|(a, b)| a - b).collect();
    let relative = dot(&difference, &difference).sqrt() / norm;
    let cosine = dot(found, expected) / (norm * dot(found, found).sqrt());
    // The component along the reference must be neither too long nor too short.
    let bias = dot(&difference, expected) / (norm * norm);
    if relative <= 1e-3 && cosine >= 0.9999 && bias.abs() <= 5e-4 {
        return Ok(());
    }
    Err(format!("relative L2 {relative:.2e}, cosine {cosine:.6}, bias {bias:.2e}"))
}

mod tests {
    use super::*;

    #[test]
    fn wrong_images_are_detected() {
        let expected: Vec<f64> = (0..1000).map(|i| f64::from(i) / 1000.0).collect();
        let mut found: Vec<f32> = expected.iter().map(|&v| v as f32).collect();
        assert_eq!(mostly_within(&found, &expected, 1e-4, 1e-3), Ok(()));
        found[3] += 0.5;
        assert_eq!(mostly_within(&found, &expected, 1e-4, 1e-3), Ok(()));
        found[4] += 2e-4;
        assert!(mostly_within(&found, &expected, 1e-4, 1e-3).is_err());
        found[3] = f32::NAN;
        assert!(mostly_within(&found, &expected, 1.0, 1.0).is_err());
        assert!(mostly_within(&found[1..], &expected, 1.0, 1.0).is_err());
        assert!(mostly_within(&[], &[], 1.0, 1.0).is_err());
    }

    #[test]
    fn wrong_gradients_are_detected() {
        let expected: Vec<f64> = (0..1000).map(|i| f64::from(i % 17) - 8.0).collect();
        let scaled = |by: f64| expected.iter().map(|v| v * by).collect::<Vec<_>>();
        assert_eq!(gradients_agree(&scaled(1.0), &expected), Ok(()));
        assert!(gradients_agree(&scaled(-1.0), &expected).is_err());
        assert!(gradients_agree(&scaled(1.0008), &expected).is_err());
        let mut one_off = expected.clone();
        one_off[0] += 1.0;
        assert!(gradients_agree(&one_off, &expected).is_err());
        assert!(gradients_agree(&scaled(f64::NAN), &expected).is_err());
        assert!(gradients_agree(&[0.0], &[0.0]).is_err());
        assert!(gradients_agree(&expected[1..], &expected).is_err());
    }
}
