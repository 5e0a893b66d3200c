//! The scene: 3D Gaussians as a structure of arrays, in the parameterisation that is trained.

pub mod compressed;
pub mod crop;
pub mod glb;
pub mod placement;
pub mod ply;
pub mod sog;
pub mod spz;
pub mod usd;

use glam::DVec3;

/// Y_0^0, the constant harmonic.
pub(crate) const Y00: f32 = 0.282_094_8;

/// Whether each harmonic changes sign when y and z do: 1; y, z, x; xy, yz, 2zz-xx-yy, xz, xx-yy;
/// y(3xx-yy), xyz, y(4zz-xx-yy), z(2zz-3xx-3yy), x(4zz-xx-yy), z(xx-yy), x(xx-3yy).
const ODD_IN_YZ: [bool; 16] = [
    false, true, true, false, true, false, false, true, false, true, false, true, true, false,
    true, false,
];

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

    /// The opacity of Gaussian `index`, 0 to 1.
    pub fn opacity(&self, index: usize) -> f64 {
        1.0 / (1.0 + (-f64::from(self.opacity_logits[index])).exp())
    }

    /// The rotation of Gaussian `index` as a unit quaternion w, x, y, z.
    pub fn rotation(&self, index: usize) -> [f64; 4] {
        let quat = self.quats[index].map(f64::from);
        let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        quat.map(|q| q / length)
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

    /// The same Gaussians after half a turn about x, which makes y point up and z backwards. Only
    /// signs change.
    #[must_use]
    pub fn turned_y_up(&self) -> Self {
        let row = 3 * self.coefficients();
        let mut turned = self.clone();
        for [_, y, z] in &mut turned.means {
            (*y, *z) = (-*y, -*z);
        }
        // The axes of an ellipsoid have no sign, so conjugation by the turn suffices.
        for [_, _, y, z] in &mut turned.quats {
            (*y, *z) = (-*y, -*z);
        }
        for sh in turned.sh.chunks_exact_mut(row) {
            for (rgb, is_odd) in sh.chunks_exact_mut(3).zip(ODD_IN_YZ) {
                rgb.iter_mut().filter(|_| is_odd).for_each(|value| *value = -*value);
            }
        }
        turned
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
mod fixtures;

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
    #[test]
    fn a_scene_turned_y_up_looks_the_same_from_cameras_turned_with_it() {
        use crate::splat::reference::harmonics::basis;
        let turn = |[x, y, z]: [f64; 3]| [x, -y, -z];
        let scene = fixtures::scattered(20, 3.0, 3);
        let turned = scene.turned_y_up();
        let colour = |scene: &Gaussians, index: usize, direction| -> [f64; 3] {
            let (sh, basis) = (&scene.sh[48 * index..][..48], basis(direction));
            let channel = |c: usize| (0..16).map(|k| f64::from(sh[3 * k + c]) * basis[k]).sum();
            std::array::from_fn(channel)
        };
        // Where an axis of the ellipsoid ends, up to its sign.
        let axis = |scene: &Gaussians, index: usize, axis: usize| {
            let [w, x, y, z] = scene.rotation(index);
            glam::DQuat::from_xyzw(x, y, z, w) * DVec3::AXES[axis]
        };
        for index in 0..scene.len() {
            assert_eq!(turned.means[index].map(f64::from), turn(scene.means[index].map(f64::from)));
            let [x, y, z, _] = scene.quats[index].map(f64::from);
            let direction = DVec3::new(x, y, z).normalize().to_array();
            let (ours, theirs) =
                (colour(&scene, index, direction), colour(&turned, index, turn(direction)));
            assert!((0..3).all(|c| (ours[c] - theirs[c]).abs() < 1e-9), "{ours:?} {theirs:?}");
            for side in 0..3 {
                let ours = DVec3::from(turn(axis(&scene, index, side).to_array()));
                assert!(ours.dot(axis(&turned, index, side)).abs() > 1.0 - 1e-9);
            }
        }
    }
}
