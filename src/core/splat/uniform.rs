//! The camera uniform of the kernels.

use bytemuck::{Pod, Zeroable};

use crate::camera::Camera;

/// Side of a tile, px.
pub const TILE: u32 = 16;

/// Depth below which splats are culled, world units; the same for training and rendering. Lower
/// than the usual 0.2 scene units: hand-held cameras come close, and a scene has no known unit.
pub const NEAR: f32 = 0.01;

/// `CameraUniform` of shaders/shared/camera.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct CameraUniform {
    /// First row of world to camera.
    pub row_x: [f32; 4],
    /// Second row.
    pub row_y: [f32; 4],
    /// Third row.
    pub row_z: [f32; 4],
    /// Focal lengths, px.
    pub focal: [f32; 2],
    /// Principal point, px.
    pub centre: [f32; 2],
    /// Image size, px.
    pub size: [u32; 2],
    /// Image size in tiles, rounded up.
    pub tiles: [u32; 2],
    /// Centre of projection, world units.
    pub position: [f32; 3],
    /// Active degree of the spherical harmonics.
    pub sh_degree: u32,
    /// Background colour, RGB in the image's encoding.
    pub background: [f32; 3],
    /// Number of Gaussians.
    pub count: u32,
    /// Near plane, world units.
    pub near: f32,
    /// Vectors of four in a row of harmonics.
    pub sh_row: u32,
    /// Padding required by the shader's alignment.
    pub padding: [u32; 2],
}

impl CameraUniform {
    /// The uniform of a camera for `count` Gaussians whose arrays hold harmonics of degree
    /// `allocated`, of which those up to `active` are used.
    pub fn new(camera: &Camera, count: usize, active: u32, allocated: u32, near: f32) -> Self {
        let rows = camera.world_to_camera.transpose();
        let row = |v: glam::DVec4| v.to_array().map(|x| x as f32);
        let k = &camera.intrinsics;
        let centre = camera.centre();
        let tiles = |pixels: usize| (pixels as u32).div_ceil(TILE);
        Self {
            row_x: row(rows.x_axis),
            row_y: row(rows.y_axis),
            row_z: row(rows.z_axis),
            focal: [k.fx as f32, k.fy as f32],
            centre: [k.cx as f32, k.cy as f32],
            size: [k.width as u32, k.height as u32],
            tiles: [tiles(k.width), tiles(k.height)],
            position: centre.to_array().map(|x| x as f32),
            sh_degree: active.min(allocated),
            count: count as u32,
            near,
            sh_row: (3 * (allocated + 1) * (allocated + 1)).div_ceil(4),
            background: [0.0; 3],
            padding: [0; 2],
        }
    }

    /// Replaces the black background.
    #[must_use]
    pub fn before(self, background: [f32; 3]) -> Self {
        Self { background, ..self }
    }
}
