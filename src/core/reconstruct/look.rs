//! Renders of the scene in training, for observers.

use fled_gpu::GpuError;

use super::training::Training;
use crate::camera::Camera;
use crate::image::Image;

/// A moment of a round with nothing in flight.
pub struct Look<'a> {
    /// Steps done.
    pub step: u32,
    /// Steps of the round.
    pub steps: u32,
    /// Wall seconds of the round so far, in all processes.
    pub seconds: f64,
    /// The number of steps that the round is to have instead.
    pub(super) change: Option<u32>,
    pub(super) scene: &'a mut dyn Training,
    /// Active degree of the harmonics.
    pub(super) degree: u32,
}

impl Look<'_> {
    /// Whether the round ends here.
    pub fn is_last(&self) -> bool {
        self.step == self.steps
    }

    /// Changes the number of steps of the round, to at least one more than are done; of no effect
    /// after the last. What depends on a step's share of them goes on
    /// from the share that it then has.
    pub fn change_steps(&mut self, steps: u32) {
        self.change = Some(steps);
    }

    /// Renders the scene through `camera`, over black, as it would be delivered now; sRGB-encoded,
    /// not clamped above.
    ///
    /// # Errors
    /// A device error.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, GpuError> {
        self.scene.look(camera, self.degree)
    }
}
