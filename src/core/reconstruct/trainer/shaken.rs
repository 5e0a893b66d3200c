//! Between steps: how each view is shaken, judged by its render as the scene stands.

use fled_gpu::GpuError;
use rayon::prelude::*;

use super::Trainer;
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::reconstruct::ReconstructError;
use crate::shake::{self, Shake, ShakeKernel};
use crate::splat::rasterize::Forward;
use crate::splat::uniform::{CameraUniform, NEAR};

/// Renders that are held at once.
const AT_ONCE: usize = 8;

impl Trainer<'_> {
    pub(super) fn estimates_shake(&self, step: u32) -> bool {
        self.shake.is_some() && self.schedule.estimates_shake(step)
    }

    /// Solves for the kernels of all views anew.
    pub(super) fn estimate_shake(
        &mut self,
        step: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        let Some(response) = &self.config.shake else {
            return Ok(());
        };
        let all: Vec<usize> = (0..self.views.len()).collect();
        for some in all.chunks(AT_ONCE) {
            cancel.check()?;
            let renders = some
                .iter()
                .map(|&view| self.render_view(view, step))
                .collect::<Result<Vec<_>, _>>()?;
            let kernels: Vec<ShakeKernel> = some
                .par_iter()
                .zip(&renders)
                .map(|(&view, render)| {
                    let photograph = self.photograph(view, render.width(), render.height());
                    shake::estimate(render, &photograph, response)
                })
                .collect();
            if let Some(shake) = &mut self.shake {
                for ((&view, kernel), render) in some.iter().zip(kernels).zip(&renders) {
                    shake.set(view, [render.width(), render.height()], kernel)?;
                }
            }
        }
        Ok(())
    }

    /// The scene from a training view, as `step` would see it.
    fn render_view(&mut self, view: usize, step: u32) -> Result<Image, GpuError> {
        let camera = self.level.views[view].camera;
        self.render_from(&camera, step, None)
    }

    /// The scene through `camera`, no larger than the views, as `step` would see it; as shaken as
    /// the view `like` is.
    pub(super) fn render_from(
        &mut self,
        camera: &Camera,
        step: u32,
        like: Option<usize>,
    ) -> Result<Image, GpuError> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let (degree, allocated) = (self.schedule.degree(step), self.gaussians.sh_degree);
        loop {
            let uniform = CameraUniform::new(camera, self.gaussians.count, degree, allocated, NEAR);
            self.projection.camera.write(&[uniform])?;
            let mut recorder = self.gpu.recorder();
            self.projection.record(&mut recorder, &self.gaussians)?;
            Forward::new(self.specialisation).record(
                &mut recorder,
                &self.projection,
                &self.raster,
            )?;
            let image = match (&self.shake, like) {
                (Some(shake), Some(view)) => {
                    shake.record_forward(&mut recorder, view, &self.raster.image)?;
                    shake.blurred()
                }
                _ => &self.raster.image,
            };
            recorder.submit()?;
            let counts = self.raster.counts()?;
            let image = image.start_read(3 * width * height)?;
            let counts = counts.wait()?;
            if !counts.overflowed() {
                return Ok(Image::from_planar(width, height, image.wait()?));
            }
            self.grow_raster(counts.intersections)?;
        }
    }

    /// Forgets the kernels: those of another resolution say nothing about this one.
    pub(super) fn still_views(&mut self) -> Result<(), GpuError> {
        self.set_kernels(std::iter::repeat(ShakeKernel::still()))
    }

    /// Takes up the kernels of a checkpoint, at the level's resolution.
    pub(super) fn restore_shake(&mut self, state: &[f32]) -> Result<(), ReconstructError> {
        if self.shake.is_none() {
            return Ok(());
        }
        let kernels = Shake::parse(state, self.views.len()).ok_or(ReconstructError::OtherRound)?;
        Ok(self.set_kernels(kernels)?)
    }

    fn set_kernels(
        &mut self,
        kernels: impl IntoIterator<Item = ShakeKernel>,
    ) -> Result<(), GpuError> {
        let Some(shake) = &mut self.shake else {
            return Ok(());
        };
        for (index, (view, kernel)) in self.level.views.iter().zip(kernels).enumerate() {
            let k = &view.camera.intrinsics;
            shake.set(index, [k.width, k.height], kernel)?;
        }
        Ok(())
    }
}
