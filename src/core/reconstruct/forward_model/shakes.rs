//! Estimation of the views' shake by renders of the current scene.

use fled_gpu::GpuError;
use rayon::prelude::*;

use super::ForwardModel;
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::mask::Mask;
use crate::reconstruct::ReconstructError;
use crate::shake::{self, DeviceKernel, ShakeKernel};

/// Number of renders held at once.
const AT_ONCE: usize = 8;

impl ForwardModel<'_> {
    /// Solves again for the kernels of all views that may have one.
    pub(in crate::reconstruct) fn estimate_shake(
        &mut self,
        degree: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        let Some(response) = self.shake.as_ref().map(|shake| shake.response().clone()) else {
            return Ok(());
        };
        let all: Vec<usize> =
            (0..self.views.len()).filter(|&view| self.views[view].given().has_kernel).collect();
        for some in all.chunks(AT_ONCE) {
            cancel.check()?;
            let mut renders = Vec::with_capacity(some.len());
            for &view in some {
                let camera = *self.views[view].camera();
                renders.push(self.render(&camera, degree)?);
            }
            let seen = some.iter().map(|&view| {
                let view = &self.views[view];
                (view.photograph(view.size()), view.mask(view.size()))
            });
            let seen: Vec<(Image, Option<Mask>)> = seen.collect();
            let kernels: Vec<ShakeKernel> = renders
                .par_iter()
                .zip(&seen)
                .map(|(render, (photograph, kept))| {
                    shake::estimate_by_cells(render, photograph, &response, kept.as_ref())
                })
                .collect();
            for (&view, kernel) in some.iter().zip(kernels) {
                self.set_kernel(view, kernel)?;
            }
        }
        Ok(())
    }

    fn set_kernel(&mut self, view: usize, kernel: ShakeKernel) -> Result<(), GpuError> {
        let view = &mut self.views[view];
        let size = view.size();
        match (&self.shake, &mut view.kernel) {
            (Some(shake), Some(on_device)) => shake.set(on_device, size, kernel),
            _ => Ok(()),
        }
    }

    /// Resets all views to no shake.
    pub(super) fn still_views(&mut self) -> Result<(), GpuError> {
        (0..self.views.len()).try_for_each(|view| self.set_kernel(view, ShakeKernel::still()))
    }

    fn kernels(&self) -> impl Iterator<Item = &ShakeKernel> {
        let kernels = self.views.iter().filter_map(|view| view.kernel.as_ref());
        kernels.map(DeviceKernel::kernel)
    }

    /// Mean [`ShakeKernel::spread`] over the views that may have a kernel, px; `None` without any.
    pub(in crate::reconstruct) fn mean_spread(&self) -> Option<f64> {
        self.shake.as_ref()?;
        let views = self.views.iter().zip(self.kernels());
        let spreads: Vec<f64> = views
            .filter(|(view, _)| view.given().has_kernel)
            .map(|(_, kernel)| kernel.spread())
            .collect();
        (!spreads.is_empty()).then(|| spreads.iter().sum::<f64>() / spreads.len() as f64)
    }

    /// Number of views whose shake a kernel explains.
    pub(in crate::reconstruct) fn explained(&self) -> u32 {
        let views = self.views.iter().filter(|view| view.given().has_kernel);
        self.shake.as_ref().map_or(0, |_| views.count() as u32)
    }

    /// The kernels as numbers, for a checkpoint; empty without shake.
    pub(in crate::reconstruct) fn save_kernels(&self) -> Vec<f32> {
        shake::save(self.kernels())
    }

    /// Restores the kernels of a checkpoint, at the resolution at which they were saved.
    pub(in crate::reconstruct) fn restore_kernels(
        &mut self,
        state: &[f32],
    ) -> Result<(), ReconstructError> {
        if self.shake.is_none() {
            return Ok(());
        }
        let kernels = shake::parse(state, self.views.len()).ok_or(ReconstructError::OtherRound)?;
        for (view, kernel) in kernels.into_iter().enumerate() {
            self.set_kernel(view, kernel)?;
        }
        Ok(())
    }
}
