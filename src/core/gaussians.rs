//! The scene: 3D Gaussians as a structure of arrays, in the parameterisation that is trained.

pub mod compressed;
pub mod ply;

use glam::DVec3;

/// Y_0^0, the constant harmonic.
pub(crate) const Y00: f32 = 0.282_094_8;

/// N Gaussians. Every array holds N rows, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Means, world units, [N, 3].
    pub means: Vec<[f32; 3]>,
    /// Rotations as quaternions w, x, y, z, not necessarily normalised, [N, 4].
    pub quats: Vec<[f32; 4]>,
    /// Natural logarithm of the scales in world units, [N, 3].
    pub log_scales: Vec<[f32; 3]>,
    /// Opacity before the sigmoid, [N].
    pub opacity_logits: Vec<f32>,
    /// Spherical harmonics, [N, (degree + 1)^2, 3], coefficient-major, then RGB. Colour is
    /// `0.5 + sum sh * Y`, clamped below at 0, sRGB-encoded.
    pub sh: Vec<f32>,
    /// Degree of `sh`, 0..=3.
    pub sh_degree: u32,
}

impl Gaussians {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Applies `colour` to every base colour and scales the variation with direction by `slope`,
    /// the derivative of `colour` per channel: a tone curve, to first order.
    pub fn map_colours(
        &mut self,
        colour: impl Fn([f32; 3]) -> [f32; 3],
        slope: impl Fn([f32; 3]) -> [f32; 3],
    ) {
        let row = 3 * self.coefficients();
        for sh in self.sh.chunks_exact_mut(row) {
            let base: [f32; 3] =
                std::array::from_fn(|c| 0.5 + Y00 * sh[c]).map(|v: f32| v.clamp(0.0, 1.0));
            let (mapped, slope) = (colour(base), slope(base));
            for (i, value) in sh.iter_mut().enumerate() {
                *value = if i < 3 { (mapped[i] - 0.5) / Y00 } else { *value * slope[i % 3] };
            }
        }
    }

    /// The same shapes with the colour that `colour` gives for each index, independent of
    /// direction. They may be brighter than white.
    #[must_use]
    pub fn coloured(&self, colour: impl Fn(usize) -> [f32; 3]) -> Self {
        let colours = (0..self.len()).flat_map(|i| colour(i).map(|value| (value - 0.5) / Y00));
        Self { sh: colours.collect(), sh_degree: 0, ..self.clone() }
    }

    /// Coefficients per colour channel: (degree + 1)^2.
    pub fn coefficients(&self) -> usize {
        ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }

    /// Whether all numbers of Gaussian `index` are finite and its quaternion has a direction.
    pub fn is_usable(&self, index: usize) -> bool {
        let row = 3 * self.coefficients();
        let quat = self.quats[index];
        let head = self.means[index].iter().chain(&self.log_scales[index]).chain(&quat);
        let finite = head.chain([&self.opacity_logits[index]]).all(|v| v.is_finite());
        let sh = &self.sh[index * row..(index + 1) * row];
        finite
            && sh.iter().all(|v| v.is_finite())
            && quat.iter().map(|v| v * v).sum::<f32>() >= 1e-8
    }

    /// The Gaussians at `indices`, in that order.
    pub fn select(&self, indices: &[usize]) -> Self {
        let row = 3 * self.coefficients();
        Self {
            means: indices.iter().map(|&i| self.means[i]).collect(),
            quats: indices.iter().map(|&i| self.quats[i]).collect(),
            log_scales: indices.iter().map(|&i| self.log_scales[i]).collect(),
            opacity_logits: indices.iter().map(|&i| self.opacity_logits[i]).collect(),
            sh: indices.iter().flat_map(|&i| &self.sh[i * row..(i + 1) * row]).copied().collect(),
            sh_degree: self.sh_degree,
        }
    }

    /// The same Gaussians without those that are not [usable](Self::is_usable).
    #[must_use]
    pub fn without_unusable(&self) -> Self {
        let kept: Vec<_> = (0..self.len()).filter(|&i| self.is_usable(i)).collect();
        self.select(&kept)
    }

    /// The same Gaussians in a world that is `scale` times as large and then moved by `shift`.
    #[must_use]
    pub fn moved(&self, scale: f64, shift: DVec3) -> Self {
        let mean = |mean: &[f32; 3]| DVec3::from(mean.map(f64::from)) * scale + shift;
        let log_scale = |axis: f32| (f64::from(axis) + scale.ln()) as f32;
        Self {
            means: self.means.iter().map(|at| mean(at).as_vec3().to_array()).collect(),
            log_scales: self.log_scales.iter().map(|axes| axes.map(log_scale)).collect(),
            ..self.clone()
        }
    }

    /// The same Gaussians with harmonics of `degree`: truncated, or padded with zeros.
    #[must_use]
    pub fn with_sh_degree(&self, degree: u32) -> Self {
        let (from, to) = (3 * self.coefficients(), 3 * ((degree + 1) * (degree + 1)) as usize);
        let mut sh = vec![0.0; self.len() * to];
        for (source, target) in self.sh.chunks_exact(from).zip(sh.chunks_exact_mut(to)) {
            let shared = from.min(to);
            target[..shared].copy_from_slice(&source[..shared]);
        }
        Self { sh, sh_degree: degree, ..self.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_maps_the_base_colour_and_scales_the_directional_part() {
        let one = Gaussians {
            means: vec![[0.0; 3]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            log_scales: vec![[0.0; 3]],
            opacity_logits: vec![0.0],
            sh: vec![0.0; 3],
            sh_degree: 0,
        };
        let mut mapped = one.with_sh_degree(1);
        mapped.sh[3] = 0.2;
        mapped.map_colours(|rgb| rgb.map(|v| v / 2.0), |_| [0.5; 3]);
        let base = 0.5 + 0.282_094_8 * mapped.sh[0];
        assert!((base - 0.25).abs() < 1e-6, "{base}");
        assert!((mapped.sh[3] - 0.1).abs() < 1e-7, "{}", mapped.sh[3]);
    }
}
