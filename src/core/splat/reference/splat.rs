//! A Gaussian in f64.

use crate::gaussians::Gaussians;

/// Columns of a row of [`Splat::flatten`].
pub mod column {
    use std::ops::Range;

    /// World units.
    pub const MEAN: Range<usize> = 0..3;
    /// Natural logarithm of world units.
    pub const LOG_SCALE: Range<usize> = 3..6;
    /// w x y z.
    pub const QUAT: Range<usize> = 6..10;
    /// Before the sigmoid.
    pub const OPACITY_LOGIT: usize = 10;
    /// First column of the coefficients, which extend to the end.
    pub const HARMONICS: usize = 11;
}

/// One Gaussian in f64, in the trained parameterisation. The same struct holds its gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct Splat {
    /// World units.
    pub mean: [f64; 3],
    /// Natural logarithm of world units.
    pub log_scale: [f64; 3],
    /// w, x, y, z; not necessarily normalised.
    pub quat: [f64; 4],
    /// Before the sigmoid.
    pub opacity_logit: f64,
    /// Coefficients, [(degree + 1)^2, 3].
    pub sh: Vec<[f64; 3]>,
}

impl Splat {
    /// The `index`-th of `gaussians`.
    pub fn from_gaussians(gaussians: &Gaussians, index: usize) -> Self {
        let k = gaussians.coefficients();
        let sh = &gaussians.sh[index * k * 3..(index + 1) * k * 3];
        Self {
            mean: gaussians.means[index].map(f64::from),
            log_scale: gaussians.log_scales[index].map(f64::from),
            quat: gaussians.quats[index].map(f64::from),
            opacity_logit: f64::from(gaussians.opacity_logits[index]),
            sh: sh.chunks_exact(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect(),
        }
    }

    /// A gradient of zero for `coefficients` coefficients.
    pub fn zero(coefficients: usize) -> Self {
        Self {
            mean: [0.0; 3],
            log_scale: [0.0; 3],
            quat: [0.0; 4],
            opacity_logit: 0.0,
            sh: vec![[0.0; 3]; coefficients],
        }
    }

    /// All values in a row: mean, log-scale, quaternion, opacity, harmonics.
    pub fn flatten(&self) -> Vec<f64> {
        let head =
            self.mean.iter().chain(&self.log_scale).chain(&self.quat).chain([&self.opacity_logit]);
        head.chain(self.sh.iter().flatten()).copied().collect()
    }

    /// The inverse of [`Splat::flatten`].
    pub fn unflatten(row: &[f64]) -> Self {
        let (sh, _) = row[column::HARMONICS..].as_chunks();
        Self {
            mean: numbers(row, column::MEAN),
            log_scale: numbers(row, column::LOG_SCALE),
            quat: numbers(row, column::QUAT),
            opacity_logit: row[column::OPACITY_LOGIT],
            sh: sh.to_vec(),
        }
    }
}

fn numbers<const N: usize>(row: &[f64], columns: std::ops::Range<usize>) -> [f64; N] {
    std::array::from_fn(|i| row[columns.start + i])
}
