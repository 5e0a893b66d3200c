//! Estimation of the views' shake by renders of the current scene.

use rayon::prelude::*;

use super::ForwardModel;
use crate::cancel::CancelToken;
use crate::device::Scene;
use crate::image::Image;
use crate::mask::Mask;
use crate::reconstruct::ReconstructError;
use crate::shake::{self, ShakeKernel};

/// Number of renders held at once.
const AT_ONCE: usize = 8;

impl ForwardModel<'_> {
    /// Solves again for the kernels of all views that may have one.
    pub(in crate::reconstruct) fn estimate_shake(
        &mut self,
        scene: &mut dyn Scene,
        degree: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        let Some(response) = &self.response else {
            return Ok(());
        };
        let all: Vec<usize> =
            (0..self.views.len()).filter(|&view| self.views[view].given().has_kernel).collect();
        for some in all.chunks(AT_ONCE) {
            cancel.check()?;
            let mut renders = Vec::with_capacity(some.len());
            for &view in some {
                renders.push(scene.render(self.views[view].camera(), degree)?);
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
                    shake::estimate_by_cells(render, photograph, response, kept.as_ref())
                })
                .collect();
            for (&view, kernel) in some.iter().zip(kernels) {
                self.views[view].kernel = kernel;
            }
        }
        Ok(())
    }

    /// Mean [`ShakeKernel::spread`] over the views that may have a kernel, px; `None` without any.
    pub(in crate::reconstruct) fn mean_spread(&self) -> Option<f64> {
        self.response.as_ref()?;
        let views = self.views.iter().filter(|view| view.given().has_kernel);
        let spreads: Vec<f64> = views.map(|view| view.kernel.spread()).collect();
        (!spreads.is_empty()).then(|| spreads.iter().sum::<f64>() / spreads.len() as f64)
    }

    /// Number of views whose shake a kernel explains.
    pub(in crate::reconstruct) fn explained(&self) -> u32 {
        let views = self.views.iter().filter(|view| view.given().has_kernel);
        self.response.as_ref().map_or(0, |_| views.count() as u32)
    }

    /// The kernels as numbers, for a checkpoint; empty without shake.
    pub(in crate::reconstruct) fn save_kernels(&self) -> Vec<f32> {
        let views = self.response.iter().flat_map(|_| &self.views);
        shake::save(views.map(|view| &view.kernel))
    }

    /// Restores the kernels of a checkpoint, at the resolution at which they were saved.
    pub(in crate::reconstruct) fn restore_kernels(
        &mut self,
        state: &[f32],
    ) -> Result<(), ReconstructError> {
        if self.response.is_none() {
            return Ok(());
        }
        let kernels = shake::parse(state, self.views.len()).ok_or(ReconstructError::OtherRound)?;
        for (view, kernel) in self.views.iter_mut().zip(kernels) {
            view.kernel = kernel;
        }
        Ok(())
    }
}
