//! The scene: 3D Gaussians as a structure of arrays, in the parameterisation that is trained.

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

    /// Coefficients per colour channel: (degree + 1)^2.
    pub fn coefficients(&self) -> usize {
        ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }
}
