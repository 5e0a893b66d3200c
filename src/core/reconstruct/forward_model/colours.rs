//! Exposure and cast of each view, judged by its render as the scene stands.

use fled_gpu::GpuError;

use super::ForwardModel;
use crate::cancel::CancelToken;
use crate::reconstruct::ReconstructError;
use crate::reconstruct::colour::{self, ViewColour};

impl ForwardModel<'_> {
    /// Fits the colours of all views anew; what they have in common stays the scene's.
    pub(in crate::reconstruct) fn match_colours(
        &mut self,
        degree: u32,
        cancel: &CancelToken,
    ) -> Result<(), ReconstructError> {
        let mut colours = Vec::with_capacity(self.views.len());
        for view in 0..self.views.len() {
            cancel.check()?;
            let camera = *self.views[view].camera();
            let render = self.render_shaken(view, &camera, degree)?;
            let photograph = self.views[view].photograph();
            colours.push(ViewColour::between(&render, &photograph));
        }
        colour::hold_gauge(&mut colours);
        Ok(self.set_colours(colours)?)
    }

    fn set_colours(
        &mut self,
        colours: impl IntoIterator<Item = ViewColour>,
    ) -> Result<(), GpuError> {
        let mut pairs = self.views.iter_mut().zip(colours);
        pairs.try_for_each(|(view, colour)| view.set_colour(colour))
    }

    /// The colours as numbers, for a checkpoint.
    pub(in crate::reconstruct) fn save_colours(&self) -> Vec<f32> {
        let rows = self.views.iter().map(|view| view.colour().to_row());
        rows.flatten().collect()
    }

    /// Takes up the colours of a checkpoint.
    pub(in crate::reconstruct) fn restore_colours(
        &mut self,
        state: &[f32],
    ) -> Result<(), ReconstructError> {
        let (rows, rest) = state.as_chunks();
        if rows.len() != self.views.len() || !rest.is_empty() {
            return Err(ReconstructError::OtherRound);
        }
        Ok(self.set_colours(rows.iter().map(|&row| ViewColour::from_row(row)))?)
    }
}
