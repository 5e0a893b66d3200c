//! The viewpoint of a rendering.

use crate::camera::Camera;

/// The parameters of a rendering: camera, active degree and near plane.
#[derive(Clone, Copy, Debug)]
pub struct Viewpoint {
    /// The camera.
    pub camera: Camera,
    /// Active degree of the harmonics.
    pub sh_degree: u32,
    /// Near plane, world units.
    pub near: f64,
}
