//! Densification between steps.

use fled_gpu::GpuError;

use super::Trainer;
use crate::reconstruct::densify::{self, classic};
use crate::reconstruct::optimizer::GeometryMoments;
use crate::reconstruct::schedule::Stream;
use crate::reconstruct::{Densify, ReconstructError};
use crate::splat::rows::GeometryRow;

/// Share of its steps before which a warm round does not grow.
const WARM_GROWTH: f64 = 0.05;

impl Trainer<'_> {
    pub(super) fn densifies(&self, step: u32) -> bool {
        self.schedule.densifies(step) || self.resets_opacities(step)
    }

    fn resets_opacities(&self, step: u32) -> bool {
        self.config.densify == Densify::Classic && self.schedule.resets_opacities(step)
    }

    pub(super) fn densify(&mut self, step: u32) -> Result<(), ReconstructError> {
        match self.config.densify {
            Densify::Mcmc => Ok(self.relocate(step)?),
            Densify::Classic => self.clone_and_split(step),
        }
    }

    fn relocate(&mut self, step: u32) -> Result<(), GpuError> {
        let rows = self.scene.geometry()?;
        let count = rows.len();
        let target = if self.config.warm && self.schedule.share(step) < WARM_GROWTH {
            count
        } else {
            let densifications = self.schedule.densifications();
            densify::grown(count, self.start_count, self.config.cap, densifications)
        };
        let random = &mut self.schedule.generator(Stream::Densification, u64::from(step));
        self.scene.relocate(&densify::plan(&rows, target, random))
    }

    /// Runs on the host: it serves comparison, and reorders everything.
    fn clone_and_split(&mut self, step: u32) -> Result<(), ReconstructError> {
        let before = self.scene.save()?;
        let (rows, moments) = (before.rows(), before.moments());
        let mut after = self.descendants(&rows, &moments, step);
        let resets = self.resets_opacities(step);
        if resets {
            for one in &mut after {
                one.row.opacity_logit = classic::reset(one.row.opacity_logit);
            }
        }
        let moments: Vec<_> =
            after.iter().map(|one| moments_after(one, &moments, resets)).collect();
        self.restore_scene(&before.after(&after, &moments))
    }

    /// The Gaussians after the densification before `step`.
    fn descendants(
        &self,
        rows: &[GeometryRow],
        moments: &[GeometryMoments],
        step: u32,
    ) -> Vec<classic::Descendant> {
        if !self.schedule.densifies(step) {
            let as_is = |(source, &row): (usize, &GeometryRow)| classic::Descendant {
                source,
                row,
                new: false,
            };
            return rows.iter().enumerate().map(as_is).collect();
        }
        let gradients: Vec<classic::PositionGradient> = moments
            .iter()
            .map(|row| classic::PositionGradient {
                lengths: row.gradient_lengths,
                views: row.gradient_views,
            })
            .collect();
        classic::plan(
            rows,
            &gradients,
            self.config.cap,
            self.config.extent,
            self.config.warm || step > classic::RESET_EVERY,
            &mut self.schedule.generator(Stream::Densification, u64::from(step)),
        )
    }
}

/// The source's moments without the accumulated gradients, and without those of its opacity after a
/// reset; zero for a new Gaussian.
fn moments_after(
    one: &classic::Descendant,
    moments: &[GeometryMoments],
    resets: bool,
) -> GeometryMoments {
    if one.new {
        return GeometryMoments::default();
    }
    let mut kept =
        GeometryMoments { gradient_lengths: 0.0, gradient_views: 0.0, ..moments[one.source] };
    if resets {
        // The logit is the last trained number of a row.
        for moment in [&mut kept.first, &mut kept.second] {
            *moment.last_mut().expect("a row has numbers") = 0.0;
        }
    }
    kept
}
