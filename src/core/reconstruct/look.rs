//! Renders of the scene in training, for observers.

use fled_gpu::{Gpu, GpuError};

use crate::camera::Camera;
use crate::image::Image;
use crate::splat::pass::ForwardPass;
use crate::splat::rows::DeviceGaussians;

/// Draws the scene in training into buffers of its own, created on first use. Training's own
/// buffers stay as they are: growing them for a look would change which steps are repeated, and so
/// the scene.
#[derive(Default)]
pub(super) struct Onlooker {
    drawing: Option<Drawing>,
}

struct Drawing {
    pass: ForwardPass,
    /// Largest width and height so far, px.
    size: [usize; 2],
}

/// A moment of a round with nothing in flight.
pub struct Look<'a> {
    /// Steps done.
    pub step: u32,
    /// Whether the round ends here.
    pub is_last: bool,
    pub(super) gpu: &'a Gpu,
    pub(super) gaussians: &'a DeviceGaussians,
    /// Active degree of the harmonics.
    pub(super) degree: u32,
    pub(super) onlooker: &'a mut Onlooker,
}

impl Look<'_> {
    /// Renders the scene through `camera`, over black, as it would be delivered now; sRGB-encoded,
    /// not clamped above.
    ///
    /// # Errors
    /// A device error.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, GpuError> {
        let size = [camera.intrinsics.width, camera.intrinsics.height];
        let drawing = self.onlooker.fitting(self.gpu, self.gaussians, size)?;
        drawing.pass.gaussians.count = self.gaussians.count;
        drawing.pass.image(camera, self.degree, |pass| {
            pass.recorder()?.submit()?;
            Ok(pass.buffers().image.clone())
        })
    }
}

impl Onlooker {
    /// Buffers that hold an image of this size.
    fn fitting(
        &mut self,
        gpu: &Gpu,
        gaussians: &DeviceGaussians,
        size: [usize; 2],
    ) -> Result<&mut Drawing, GpuError> {
        let mut drawing = match self.drawing.take() {
            Some(drawing) => drawing,
            None => Drawing {
                // The clone shares the buffers in training.
                pass: ForwardPass::new(gpu, gaussians.clone(), size, false)?,
                size,
            },
        };
        let larger = [0, 1].map(|side| drawing.size[side].max(size[side]));
        if larger != drawing.size {
            drawing.pass.set_size(larger)?;
            drawing.size = larger;
        }
        Ok(self.drawing.insert(drawing))
    }
}
