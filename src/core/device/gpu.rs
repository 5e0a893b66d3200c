//! Scenes on a GPU.

use fled_gpu::{Buffer, Gpu, GpuError};

use super::scene::{Scene, Shaken};
use crate::camera::Camera;
use crate::image::Image;
use crate::shake::{DeviceKernel, Response, Shake};
use crate::splat::pass::{ForwardPass, PassRecording};
use crate::splat::rasterize::SplatCounts;
use crate::splat::rows::DeviceGaussians;

/// A scene on a GPU.
pub struct GpuScene {
    gpu: Gpu,
    pub pass: ForwardPass,
    /// Largest width and height so far, px.
    size: [usize; 2],
    /// The drawing of an image.
    drawing: Option<PassRecording>,
    /// For [`Scene::render_shaken`], with its own kernel.
    shake: Option<(Shake, DeviceKernel)>,
}

impl GpuScene {
    /// For images of at most `size` px at first. `gradients`: whether to allocate the buffers of a
    /// backward pass.
    ///
    /// # Errors
    /// Out of memory, or more Gaussians than the adapter can bind.
    pub fn new(
        gpu: &Gpu,
        gaussians: DeviceGaussians,
        size: [usize; 2],
        gradients: bool,
    ) -> Result<Self, GpuError> {
        let pass = ForwardPass::new(gpu, gaussians, size, gradients)?;
        Ok(Self { gpu: gpu.clone(), pass, size, drawing: None, shake: None })
    }

    /// Grows the image's buffers to this size.
    fn fit(&mut self, size: [usize; 2]) -> Result<(), GpuError> {
        self.size = [0, 1].map(|n| self.size[n].max(size[n]));
        self.pass.set_size(self.size)
    }

    /// The shake with room for the largest image so far.
    ///
    /// # Errors
    /// Out of memory.
    pub fn shake(&mut self, response: &Response) -> Result<&mut (Shake, DeviceKernel), GpuError> {
        let kept = self.shake.take().filter(|(shake, _)| shake.fits(self.size));
        let shake = match kept {
            Some(shake) => shake,
            None => {
                let shake = Shake::new(&self.gpu, self.size, response)?;
                (shake, DeviceKernel::new(&self.gpu)?)
            }
        };
        Ok(self.shake.insert(shake))
    }
}

impl Scene for GpuScene {
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        self.fit(camera.size())?;
        let drawing = &mut self.drawing;
        self.pass.image(camera, degree, |pass| {
            let kept = drawing.take().filter(|kept| pass.serves(kept));
            let recording = match kept {
                Some(recording) => recording,
                None => pass.keep(pass.recorder()?),
            };
            drawing.insert(recording).submit()?;
            Ok(pass.buffers().image.clone())
        })
    }

    fn render_shaken(
        &mut self,
        camera: &Camera,
        degree: u32,
        shaken: Shaken<'_>,
    ) -> Result<Image, GpuError> {
        self.fit(camera.size())?;
        let (shake, kernel) = self.shake(shaken.response)?;
        shake.set(kernel, camera.size(), shaken.kernel.clone())?;
        let Self { pass, shake, .. } = self;
        pass.image(camera, degree, |pass| {
            let mut recorder = pass.recorder()?;
            let mut image: Buffer<f32> = pass.buffers().image.clone();
            if let Some((shake, kernel)) = &*shake {
                shake.record_forward(&mut recorder, kernel, &image)?;
                image = shake.blurred().clone();
            }
            recorder.submit()?;
            Ok(image)
        })
    }

    fn counts(&self) -> Result<SplatCounts, GpuError> {
        self.pass.buffers().counts()?.wait()
    }
}
