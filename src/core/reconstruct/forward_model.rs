//! The forward model: renders the scene's Gaussians from the camera of each view and applies the
//! view's shake. Cameras and kernels are estimated here, from renders of the current scene.

pub(super) mod poses;
mod shakes;

use fled_gpu::{Gpu, GpuError};

use super::observed::Observed;
use super::{ReconstructError, TrainingView};
use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::shake::{DeviceKernel, Response, Shake};
use crate::splat::pass::ForwardPass;
use crate::splat::rows::DeviceGaussians;

/// The scene and its views. Renders forward only; the trainer runs the backward pass through it.
pub(super) struct ForwardModel<'a> {
    pub(super) pass: ForwardPass,
    /// `None` without shake.
    pub(super) shake: Option<Shake>,
    /// In the order given.
    pub(super) views: Vec<Observed<'a>>,
    /// The kernel of the render whose camera is being corrected; `None` without shake.
    kernel: Option<DeviceKernel>,
}

/// The requirements on a [`ForwardModel`].
#[derive(Clone, Copy)]
pub(super) struct Purpose<'r> {
    /// The response from light to the views' values, if they are shaken; else `None`.
    pub(super) shake: Option<&'r Response>,
    /// Minimum number of Gaussians that it has room for.
    pub(super) capacity: usize,
    /// Whether gradients will be computed.
    pub(super) gradients: bool,
}

impl<'a> ForwardModel<'a> {
    /// The views at full resolution, without shake, at the given cameras.
    pub(super) fn new(
        gpu: &Gpu,
        views: &'a [TrainingView],
        gaussians: &Gaussians,
        purpose: Purpose<'_>,
    ) -> Result<Self, ReconstructError> {
        if views.is_empty() || gaussians.is_empty() {
            return Err(ReconstructError::Empty { views: views.len(), gaussians: gaussians.len() });
        }
        let size = largest(views);
        let shake = purpose.shake.map(|response| Shake::new(gpu, size, response));
        let shake = shake.transpose()?;
        let kernel = || shake.as_ref().map(|_| DeviceKernel::new(gpu)).transpose();
        let observed = |view| Ok(Observed::new(view, kernel()?));
        let views = views.iter().map(observed).collect::<Result<Vec<_>, GpuError>>()?;
        let device = DeviceGaussians::upload(gpu, gaussians, purpose.capacity)?;
        let mut model = Self {
            pass: ForwardPass::new(gpu, device, size, purpose.gradients)?,
            kernel: kernel()?,
            shake,
            views,
        };
        model.reduce(1)?;
        Ok(model)
    }

    /// Reduces the images by `divisor` and resets the kernels, which depend on the resolution.
    pub(super) fn reduce(&mut self, divisor: usize) -> Result<(), GpuError> {
        self.views.iter_mut().for_each(|view| view.reduce(divisor));
        self.still_views()
    }

    /// The views' current cameras, at the full size of their images.
    pub(super) fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(Observed::full_camera).collect()
    }

    /// Renders the scene through `camera`, no larger than the views, with harmonics up to `degree`.
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        self.pass.image(camera, degree, |pass| {
            pass.recorder()?.submit()?;
            Ok(pass.buffers().image.clone())
        })
    }
}

/// Largest width and height.
pub(super) fn largest(views: &[TrainingView]) -> [usize; 2] {
    let most = |side: fn(&TrainingView) -> usize| views.iter().map(side).max().unwrap_or(0);
    [most(|v| v.image.width()), most(|v| v.image.height())]
}
