//! The rendering interface of a device.

use fled_gpu::GpuError;

use crate::camera::Camera;
use crate::image::Image;
use crate::shake::{Response, ShakeKernel};
use crate::splat::rasterize::SplatCounts;

/// The shake of a render.
#[derive(Clone, Copy, Debug)]
pub struct Shaken<'a> {
    /// The kernel, at the size of the render.
    pub kernel: &'a ShakeKernel,
    /// From light to the render's values; the same one for all renders of a scene.
    pub response: &'a Response,
}

/// A scene on a device.
pub trait Scene: Send {
    /// Renders the scene through `camera` with harmonics up to `degree`; sRGB-encoded, over black,
    /// not clamped above.
    ///
    /// # Errors
    /// A device error, typically out of memory.
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError>;

    /// [`Scene::render`], then shaken.
    ///
    /// # Errors
    /// As [`Scene::render`].
    fn render_shaken(
        &mut self,
        camera: &Camera,
        degree: u32,
        shaken: Shaken<'_>,
    ) -> Result<Image, GpuError>;

    /// The counts of the last image, all 0 before the first.
    ///
    /// # Errors
    /// A device error.
    fn counts(&self) -> Result<SplatCounts, GpuError>;
}
