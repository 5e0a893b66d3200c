//! Checks whether the noise field models noise, or the scene.

/// |correlation| of map and render above which the field models the scene instead of the noise.
pub const CORRELATION_LIMIT: f64 = 0.3;
/// Standard deviation (0..=1) below which no map models the scene: half an 8-bit step, of any
/// shape, cannot replace the scene, and in real rounds of 8 views such maps had correlations of
/// 0.4.
pub const LEAST_SPREAD: f64 = 0.5 / 255.0;

/// Statistics of the field's map of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inspection {
    /// Mean over pixels and channels.
    pub mean: f64,
    /// Standard deviation over pixels and channels.
    pub spread: f64,
    /// Correlation with the clean render, -1..=1; 0 when either is constant.
    pub correlation: f64,
    /// Whether the field models the scene: |correlation| exceeds [`CORRELATION_LIMIT`], and the
    /// spread [`LEAST_SPREAD`].
    pub follows_scene: bool,
}

/// Statistics of `prediction - render`, and whether it is too similar to the render.
pub fn compare(render: &[f32], prediction: &[f32]) -> Inspection {
    let n = render.len() as f64;
    let map = || {
        render.iter().zip(prediction).map(|(&r, &p)| (f64::from(r), f64::from(p) - f64::from(r)))
    };
    let (mean_render, mean) = map().fold((0.0, 0.0), |sum, (r, m)| (sum.0 + r / n, sum.1 + m / n));
    let (mut covariance, mut variance_render, mut variance) = (0.0, 0.0, 0.0);
    for (r, m) in map() {
        covariance += (r - mean_render) * (m - mean) / n;
        variance_render += (r - mean_render).powi(2) / n;
        variance += (m - mean).powi(2) / n;
    }
    // Below a hundredth of an 8-bit step the map is empty, and its correlation is that of rounding.
    let something = variance > 1e-9 && variance_render > 1e-12;
    let correlation =
        if something { covariance / (variance * variance_render).sqrt() } else { 0.0 };
    let spread = variance.sqrt();
    let follows_scene = correlation.abs() > CORRELATION_LIMIT && spread > LEAST_SPREAD;
    Inspection { mean, spread, correlation, follows_scene }
}
