//! Between steps: exposure and cast of each view, judged by its render as the scene stands.

use fled_gpu::GpuError;

use super::Trainer;
use crate::cancel::CancelToken;
use crate::image::Image;
use crate::reconstruct::ReconstructError;
use crate::reconstruct::colour::{self, ViewColour};

impl Trainer<'_> {
    pub(super) fn matches_colours(&self, step: u32) -> bool {
        self.config.view_colour && self.schedule.matches_colours(step)
    }

    /// Fits the colours of all views anew; what they have in common stays the scene's.
    pub(super) fn match_colours(
        &mut self,
        step: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        self.fit_colours(step, cancel)?;
        colour::hold_gauge(&mut self.colours);
        Ok(self.show_colours()?)
    }

    /// Fits the colours of the views to a scene that does not change.
    pub(super) fn fit_colours(
        &mut self,
        step: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        for view in 0..self.views.len() {
            cancel.check()?;
            let camera = self.level.views[view].camera;
            let render = self.render_from(&camera, step, Some(view))?;
            let photograph = self.views[view]
                .image
                .resize_area(render.width(), render.height());
            self.colours[view] = ViewColour::between(&render, &photograph);
        }
        Ok(())
    }

    /// The photograph of `view` in the colours of the scene.
    pub(super) fn photograph(&self, view: usize, width: usize, height: usize) -> Image {
        self.colours[view].undone(&self.views[view].image.resize_area(width, height))
    }

    /// Puts the photographs in the scene's colours before the loss.
    pub(super) fn show_colours(&mut self) -> Result<(), GpuError> {
        if !self.config.view_colour {
            return Ok(());
        }
        for view in 0..self.views.len() {
            let k = self.level.views[view].camera.intrinsics;
            self.level
                .show(view, &self.photograph(view, k.width, k.height))?;
        }
        Ok(())
    }

    /// Takes up the colours of a checkpoint.
    pub(super) fn restore_colours(&mut self, state: &[f32]) -> Result<(), ReconstructError> {
        let (rows, rest) = state.as_chunks::<6>();
        if rows.len() != self.views.len() || !rest.is_empty() {
            return Err(ReconstructError::OtherRound);
        }
        self.colours = rows.iter().map(|&row| ViewColour::from_row(row)).collect();
        Ok(self.show_colours()?)
    }
}
