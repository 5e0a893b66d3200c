//! Between steps: Gaussians come and go.

use fled_gpu::GpuError;

use super::Trainer;
use crate::reconstruct::Densify;
use crate::reconstruct::densify::{self, GeometryRow, classic};
use crate::reconstruct::optimizer::POSITION_GRADIENT_AT;
use crate::splat::project::GEOMETRY_ROW;

/// A warm round does not grow before this share of its steps.
const WARM_GROWTH: f64 = 0.05;
/// Floats of a row of geometry moments.
const MOMENTS_ROW: usize = 2 * GEOMETRY_ROW;

impl Trainer<'_> {
    pub(super) fn densifies(&self, step: u32) -> bool {
        self.config.densify != Densify::Off && self.schedule.densifies(step)
            || self.resets_opacities(step)
    }

    fn resets_opacities(&self, step: u32) -> bool {
        self.config.densify == Densify::Classic && self.schedule.resets_opacities(step)
    }

    pub(super) fn densify(&mut self, step: u32) -> Result<(), GpuError> {
        let count = self.model.pass.gaussians.count;
        let flat = self.model.pass.gaussians.geometry.read(count)?;
        let (rows, _) = flat.as_chunks::<GEOMETRY_ROW>();
        match self.config.densify {
            Densify::Off => Ok(()),
            Densify::Mcmc => self.relocate(rows, step),
            Densify::Classic => self.clone_and_split(rows, step),
        }
    }

    fn relocate(&mut self, rows: &[GeometryRow], step: u32) -> Result<(), GpuError> {
        let count = rows.len();
        let target = if self.config.warm && self.schedule.share(step) < WARM_GROWTH {
            count
        } else {
            densify::grown(
                count,
                self.start_count,
                self.config.cap,
                self.schedule.densifications(),
            )
        };
        let plan = densify::plan(
            rows,
            target,
            &mut self.schedule.generator(2, u64::from(step)),
        );
        self.optimizer
            .relocate(self.gpu, &self.model.pass.gaussians, &plan)?;
        self.model.pass.gaussians.count = plan.count;
        Ok(())
    }

    /// On the host: it is there for comparison, and moves everything about.
    fn clone_and_split(&mut self, rows: &[GeometryRow], step: u32) -> Result<(), GpuError> {
        let (count, optimizer) = (rows.len(), &self.optimizer);
        let sh_row = self.model.pass.gaussians.sh.length();
        let (sh, sh_moments) = (
            self.model.pass.gaussians.sh.read(count)?,
            optimizer.sh_moments.read(count)?,
        );
        let moments = optimizer.geometry_moments.read(count)?;
        let (moments, _) = moments.as_chunks::<MOMENTS_ROW>();
        let gradients: Vec<classic::PositionGradient> = moments
            .iter()
            .map(|row| POSITION_GRADIENT_AT.map(|at| row[at]))
            .collect();
        let mut after = if self.schedule.densifies(step) {
            let random = &mut self.schedule.generator(2, u64::from(step));
            let reset_before = self.config.warm || step > classic::RESET_EVERY;
            classic::plan(
                rows,
                &gradients,
                self.config.cap,
                self.config.extent,
                reset_before,
                random,
            )
        } else {
            let as_is = |source: usize| classic::Descendant {
                source,
                row: rows[source],
                new: false,
            };
            (0..count).map(as_is).collect()
        };
        if self.resets_opacities(step) {
            after
                .iter_mut()
                .for_each(|one| one.row[10] = classic::reset(one.row[10]));
        }
        let geometry: Vec<GeometryRow> = after.iter().map(|one| one.row).collect();
        let kept = |one: &classic::Descendant| {
            let mut row = if one.new {
                [0.0; MOMENTS_ROW]
            } else {
                moments[one.source]
            };
            POSITION_GRADIENT_AT
                .into_iter()
                .for_each(|at| row[at] = 0.0);
            row
        };
        let new_moments: Vec<[f32; MOMENTS_ROW]> = after.iter().map(kept).collect();
        let rows_of = |from: &[f32], length: usize, cleared: bool| -> Vec<f32> {
            let row = |one: &classic::Descendant| {
                let found = from[one.source * length..(one.source + 1) * length].iter();
                found
                    .map(|v| if cleared && one.new { 0.0 } else { *v })
                    .collect::<Vec<_>>()
            };
            after.iter().flat_map(row).collect()
        };
        self.model
            .pass
            .gaussians
            .geometry
            .write(geometry.as_flattened())?;
        optimizer
            .geometry_moments
            .write(new_moments.as_flattened())?;
        self.model
            .pass
            .gaussians
            .sh
            .write(&rows_of(&sh, sh_row, false))?;
        optimizer
            .sh_moments
            .write(&rows_of(&sh_moments, 2 * sh_row, true))?;
        self.model.pass.gaussians.count = after.len();
        Ok(())
    }
}
