//! The state of a scene in training as numbers, the same for all devices.

use crate::gaussians::Gaussians;
use crate::reconstruct::densify::classic::Descendant;
use crate::reconstruct::optimizer::GeometryMoments;
use crate::splat::rows::{GEOMETRY_ROW, GeometryRow, sh_row, unpack_gaussians};

/// A scene in training: the Gaussians, the optimiser's moments, and counters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainingState {
    /// Allocated degree of the harmonics.
    pub sh_degree: u32,
    /// Slots of the intersection buffers; 0 where they need none.
    pub intersections: u32,
    /// Non-finite gradients dropped so far.
    pub non_finite: u32,
    /// Rows of geometry, [count, 12].
    pub geometry: Vec<f32>,
    /// Adam's moments of the geometry, [count, 2, 12].
    pub geometry_moments: Vec<f32>,
    /// Rows of harmonics, [count, `sh_row`].
    pub sh: Vec<f32>,
    /// Adam's moments of the harmonics, [count, 2, `sh_row`].
    pub sh_moments: Vec<f32>,
    /// The noise field's step, parameters and moments; empty without one.
    pub noise: Vec<f32>,
}

impl TrainingState {
    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.geometry.len() / GEOMETRY_ROW
    }

    /// The scene.
    pub fn gaussians(&self) -> Gaussians {
        unpack_gaussians(&self.rows(), &self.sh, self.sh_degree)
    }

    /// The geometry of all Gaussians.
    pub fn rows(&self) -> Vec<GeometryRow> {
        bytemuck::pod_collect_to_vec(&self.geometry)
    }

    /// The optimiser's moments of the geometry.
    pub fn moments(&self) -> Vec<GeometryMoments> {
        bytemuck::pod_collect_to_vec(&self.geometry_moments)
    }

    /// Whether the lengths of the arrays agree.
    pub fn is_consistent(&self) -> bool {
        let n = self.count();
        let sh = sh_row(self.sh_degree.min(3)) * n;
        let expected = [GEOMETRY_ROW * n, 2 * GEOMETRY_ROW * n, sh, 2 * sh];
        let found =
            [&self.geometry, &self.geometry_moments, &self.sh, &self.sh_moments].map(Vec::len);
        self.sh_degree <= 3 && expected == found
    }

    /// The state with only the Gaussians at `indices`, in that order, and as many fewer slots of
    /// intersections.
    #[must_use]
    pub fn select(&self, indices: &[usize]) -> Self {
        let rows = |values: &[f32], length: usize| {
            indices.iter().flat_map(|&i| &values[i * length..][..length]).copied().collect()
        };
        let row = sh_row(self.sh_degree);
        let share = indices.len() as f64 / self.count().max(1) as f64;
        Self {
            geometry: rows(&self.geometry, GEOMETRY_ROW),
            geometry_moments: rows(&self.geometry_moments, 2 * GEOMETRY_ROW),
            sh: rows(&self.sh, row),
            sh_moments: rows(&self.sh_moments, 2 * row),
            noise: self.noise.clone(),
            intersections: (f64::from(self.intersections) * share) as u32,
            ..*self
        }
    }

    /// The state after a densification, with the moments of each descendant's geometry. A
    /// descendant inherits the harmonics of its source, and their moments unless it is new.
    #[must_use]
    pub fn after(self, descendants: &[Descendant], moments: &[GeometryMoments]) -> Self {
        let geometry: Vec<GeometryRow> = descendants.iter().map(|one| one.row).collect();
        let row = sh_row(self.sh_degree);
        Self {
            geometry: bytemuck::pod_collect_to_vec(&geometry),
            geometry_moments: bytemuck::pod_collect_to_vec(moments),
            sh: inherited(&self.sh, row, descendants, |_| true),
            sh_moments: inherited(&self.sh_moments, 2 * row, descendants, |one| !one.new),
            ..self
        }
    }
}

/// The row of each descendant's source, or zeros if it does not inherit.
fn inherited(
    rows: &[f32],
    length: usize,
    descendants: &[Descendant],
    inherits: impl Fn(&Descendant) -> bool,
) -> Vec<f32> {
    let mut out = Vec::with_capacity(descendants.len() * length);
    for one in descendants {
        if inherits(one) {
            out.extend_from_slice(&rows[one.source * length..][..length]);
        } else {
            out.extend(std::iter::repeat_n(0.0, length));
        }
    }
    out
}
