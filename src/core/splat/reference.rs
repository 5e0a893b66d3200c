//! The renderer in scalar f64: specification and oracle of the kernels, not optimised.
//!
//! Conventions: OpenCV camera axes, pixel centres at +0.5, quaternions w x y z, opacity through a
//! sigmoid, scales through an exponential, colour `max(0.5 + sh . Y(direction), 0)`.

pub mod blend;
pub mod harmonics;
pub mod projection;
mod splat;

pub use blend::{Blended, blend, blend_backward};
pub use projection::{Projected, ProjectedGradient, project, project_backward};
pub use splat::{Splat, column};

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

/// Projects and blends every splat. The projections are in the order of `splats`; `None` if culled.
pub fn render(splats: &[Splat], view: &Viewpoint) -> (Vec<Option<Projected>>, Blended) {
    let projected: Vec<_> = splats.iter().map(|s| project(s, view)).collect();
    let k = &view.camera.intrinsics;
    let blended = blend(&projected, k.width, k.height);
    (projected, blended)
}

/// Gradients of every splat for `image_gradient`, planar [3, H, W].
pub fn render_backward(splats: &[Splat], view: &Viewpoint, image_gradient: &[f64]) -> Vec<Splat> {
    let (projected, blended) = render(splats, view);
    let gradients = blend_backward(&projected, &blended, image_gradient);
    splats
        .iter()
        .zip(&gradients)
        .map(|(splat, gradient)| project_backward(splat, view, gradient))
        .collect()
}

#[cfg(test)]
mod tests;
