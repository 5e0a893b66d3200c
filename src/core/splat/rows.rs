//! The Gaussians on the device, one row each.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Buffer, Gpu, GpuError, Rows, part_sizes};

use crate::gaussians::Gaussians;

/// The geometry of one Gaussian, in the layout of project_forward.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct GeometryRow {
    /// World units.
    pub mean: [f32; 3],
    /// Natural logarithm of world units.
    pub log_scale: [f32; 3],
    /// w x y z, not necessarily normalised.
    pub quat: [f32; 4],
    /// Before the sigmoid.
    pub opacity_logit: f32,
    /// Pads the row to whole vectors of four.
    pub spare: f32,
}

/// Floats of a row of `geometry`.
pub const GEOMETRY_ROW: usize = size_of::<GeometryRow>() / size_of::<f32>();

/// `PartUniform` of shaders/shared/part.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PartUniform {
    /// First Gaussian of the part.
    pub first: u32,
    /// Number of Gaussians in the part.
    pub rows: u32,
    /// Unused.
    pub pad: [u32; 2],
}

/// A part of the Gaussians: as many as the adapter can bind at once.
#[derive(Clone)]
pub struct Part {
    pub uniform: Buffer<PartUniform>,
    /// Number of Gaussians.
    pub rows: usize,
}

/// Gaussians on the device with room for more.
#[derive(Clone)]
pub struct DeviceGaussians {
    /// [capacity, 12].
    pub geometry: Rows<f32>,
    /// [capacity, [`sh_row`]].
    pub sh: Rows<f32>,
    /// The parts, each of which needs its own dispatch.
    pub parts: Vec<Part>,
    /// Number of rows that the buffers hold.
    pub capacity: usize,
    /// Number of rows in use.
    pub count: usize,
    /// Allocated degree of the harmonics.
    pub sh_degree: u32,
}

impl DeviceGaussians {
    /// Uploads `gaussians` into buffers for `capacity` rows, at least as many as there are.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn upload(gpu: &Gpu, gaussians: &Gaussians, capacity: usize) -> Result<Self, GpuError> {
        let capacity = capacity.max(gaussians.len());
        let row = sh_row(gaussians.sh_degree);
        // The longest rows per Gaussian are Adam's two moments of its harmonics or of its geometry.
        let per_part = gpu.rows_per_part(2 * size_of::<f32>() * row.max(GEOMETRY_ROW));
        let mut parts = Vec::new();
        for rows in part_sizes(capacity, per_part) {
            let uniform = PartUniform {
                first: (parts.len() * per_part) as u32,
                rows: rows as u32,
                pad: [0; 2],
            };
            parts.push(Part { uniform: gpu.upload("part", &[uniform])?, rows });
        }
        let out = Self {
            geometry: gpu.create_rows("geometry", capacity, GEOMETRY_ROW, per_part)?,
            sh: gpu.create_rows("sh", capacity, row, per_part)?,
            parts,
            capacity,
            count: gaussians.len(),
            sh_degree: gaussians.sh_degree,
        };
        out.geometry.write(bytemuck::cast_slice(&pack_geometry(gaussians)))?;
        out.sh.write(&pack_harmonics(gaussians))?;
        Ok(out)
    }

    /// Reads back the Gaussians in use.
    ///
    /// # Errors
    /// A device error.
    pub fn download(&self) -> Result<Gaussians, GpuError> {
        let sh = self.sh.read(self.count)?;
        Ok(unpack_gaussians(&self.read_geometry()?, &sh, self.sh_degree))
    }

    /// Reads back the geometry of the Gaussians in use.
    ///
    /// # Errors
    /// A device error.
    pub fn read_geometry(&self) -> Result<Vec<GeometryRow>, GpuError> {
        let numbers = self.geometry.read(self.count)?;
        Ok(bytemuck::pod_collect_to_vec(&numbers))
    }
}

/// Floats in a row of harmonics: all coefficients of three channels, padded to whole vectors of
/// four.
pub const fn sh_row(degree: u32) -> usize {
    (3 * (degree + 1) * (degree + 1)).next_multiple_of(4) as usize
}

/// Rows of `sh`.
fn pack_harmonics(gaussians: &Gaussians) -> Vec<f32> {
    let mut rows = vec![0.0; gaussians.len() * sh_row(gaussians.sh_degree)];
    let used = 3 * gaussians.coefficients();
    let sources = gaussians.sh.chunks_exact(used);
    for (row, source) in rows.chunks_exact_mut(sh_row(gaussians.sh_degree)).zip(sources) {
        row[..used].copy_from_slice(source);
    }
    rows
}

/// Rows of `geometry`.
pub fn pack_geometry(gaussians: &Gaussians) -> Vec<GeometryRow> {
    let row = |i: usize| GeometryRow {
        mean: gaussians.means[i],
        log_scale: gaussians.log_scales[i],
        quat: gaussians.quats[i],
        opacity_logit: gaussians.opacity_logits[i],
        spare: 0.0,
    };
    (0..gaussians.len()).map(row).collect()
}

/// Gaussians from rows of geometry and of harmonics.
pub fn unpack_gaussians(rows: &[GeometryRow], sh: &[f32], sh_degree: u32) -> Gaussians {
    let used = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let sh = sh.chunks_exact(sh_row(sh_degree)).flat_map(|row| &row[..used]).copied().collect();
    Gaussians {
        means: rows.iter().map(|row| row.mean).collect(),
        log_scales: rows.iter().map(|row| row.log_scale).collect(),
        quats: rows.iter().map(|row| row.quat).collect(),
        opacity_logits: rows.iter().map(|row| row.opacity_logit).collect(),
        sh,
        sh_degree,
    }
}
