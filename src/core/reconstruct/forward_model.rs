//! How the scene becomes the photographs: its Gaussians, drawn from where each view was taken,
//! shaken as each view is. What is not known of the views is learnt here, from renders
//! of the scene as it stands.

mod poses;
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

/// The scene and its photographs. Renders forward only; a trainer goes the way back through it.
pub(super) struct ForwardModel<'a> {
    pub(super) pass: ForwardPass,
    /// `None`: the views are not shaken.
    pub(super) shake: Option<Shake>,
    /// In the order in which they were given.
    pub(super) views: Vec<Observed<'a>>,
}

/// What a [`ForwardModel`] is made for.
#[derive(Clone, Copy)]
pub(super) struct Purpose<'r> {
    /// The views are shaken, and come from light like this; `None`: they are not.
    pub(super) shake: Option<&'r Response>,
    /// Room for so many Gaussians, at least as many as there are.
    pub(super) capacity: usize,
    /// Whether gradients will be asked for.
    pub(super) gradients: bool,
}

impl<'a> ForwardModel<'a> {
    /// The views at full resolution, still, where they were given.
    pub(super) fn new(
        gpu: &Gpu,
        views: &'a [TrainingView],
        gaussians: &Gaussians,
        purpose: Purpose<'_>,
    ) -> Result<Self, ReconstructError> {
        if views.is_empty() || gaussians.is_empty() {
            return Err(ReconstructError::Empty {
                views: views.len(),
                gaussians: gaussians.len(),
            });
        }
        let size = largest(views);
        let shake = purpose
            .shake
            .map(|response| Shake::new(gpu, size, response));
        let shake = shake.transpose()?;
        let observed = |view| {
            let kernel = shake.as_ref().map(|_| DeviceKernel::new(gpu)).transpose()?;
            Ok(Observed::new(view, kernel))
        };
        let views = views
            .iter()
            .map(observed)
            .collect::<Result<Vec<_>, GpuError>>()?;
        let device = DeviceGaussians::upload(gpu, gaussians, purpose.capacity)?;
        let mut model = Self {
            pass: ForwardPass::new(gpu, device, size, purpose.gradients)?,
            shake,
            views,
        };
        model.reduce(1)?;
        Ok(model)
    }

    /// Reduces the images by `divisor`, and forgets the kernels: those of another resolution say
    /// nothing about this one.
    pub(super) fn reduce(&mut self, divisor: usize) -> Result<(), GpuError> {
        self.views.iter_mut().for_each(|view| view.reduce(divisor));
        self.still_views()
    }

    /// The views' cameras, at the size of their images, as they stand now.
    pub(super) fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(Observed::full_camera).collect()
    }

    /// The scene through `camera`, no larger than the views, with harmonics up to `degree`.
    fn render(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError> {
        self.pass.image(camera, degree, |pass| {
            pass.recorder()?.submit()?;
            Ok(pass.buffers().image.clone())
        })
    }

    /// The same, as shaken as `view` is.
    fn render_shaken(
        &mut self,
        view: usize,
        camera: &Camera,
        degree: u32,
    ) -> Result<Image, GpuError> {
        let (Some(shake), Some(kernel)) = (&self.shake, &self.views[view].kernel) else {
            return self.render(camera, degree);
        };
        self.pass.image(camera, degree, |pass| {
            let mut recorder = pass.recorder()?;
            shake.record_forward(&mut recorder, kernel, &pass.buffers().image)?;
            recorder.submit()?;
            Ok(shake.blurred().clone())
        })
    }
}

/// Largest width and height.
pub(super) fn largest(views: &[TrainingView]) -> [usize; 2] {
    let most = |side: fn(&TrainingView) -> usize| views.iter().map(side).max().unwrap_or(0);
    [most(|v| v.image.width()), most(|v| v.image.height())]
}
