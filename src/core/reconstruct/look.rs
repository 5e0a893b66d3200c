//! Renders of the scene in training, for observers.

use fled_gpu::GpuError;

use super::training::Training;
use crate::camera::Camera;
use crate::image::Image;

/// A moment of a round with nothing in flight.
pub struct Look<'a> {
    /// Steps done.
    pub step: u32,
    /// Whether the round ends here.
    pub is_last: bool,
    pub(super) scene: &'a mut dyn Training,
    /// Active degree of the harmonics.
    pub(super) degree: u32,
}

impl Look<'_> {
    /// Renders the scene through `camera`, over black, as it would be delivered now; sRGB-encoded,
    /// not clamped above.
    ///
    /// # Errors
    /// A device error.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, GpuError> {
        self.scene.look(camera, self.degree)
    }
}
