//! The work between steps.

use std::time::Instant;

use fled_gpu::GpuError;

use super::Trainer;
use crate::cancel::{CancelToken, Cancelled};
use crate::metrics::report::NoiseMapStatistics;
use crate::reconstruct::forward_model::poses::Correction;
use crate::reconstruct::observed::Observed;
use crate::reconstruct::{Checkpoint, ReconstructError, TrainHooks};

/// Steps between synchronisations with the device, in a round of fewer than [`LONG`] steps and in a
/// longer one, which densifies as often. All that depends on finished steps (densification,
/// periodic checkpoints) happens only there, so that an interruption changes nothing.
const SYNC: (u32, u32) = (25, 100);
/// Steps of a long round.
const LONG: u32 = 5_000;
/// Share of non-finite updates of all Gaussians above which a round fails.
const NON_FINITE_LIMIT: f64 = 1e-3;

/// The last checkpoint handed over.
pub(super) struct Kept {
    /// The step that it precedes.
    pub(super) step: u32,
    /// Its time.
    pub(super) at: Instant,
}

impl Kept {
    /// A checkpoint made now, or the start of training.
    pub(super) fn now(step: u32) -> Self {
        let at = Instant::now();
        Self { step, at }
    }
}

impl Trainer<'_> {
    pub(super) fn is_sync(&self, step: u32) -> bool {
        let divisor = self.schedule.divisor(step);
        let every = if self.schedule.steps < LONG { SYNC.0 } else { SYNC.1 };
        step.is_multiple_of(every)
            || self.densifies(step)
            || self.estimates_shake(step)
            || self.refines_poses(step)
            || divisor != self.divisor
    }

    /// Runs [`Self::prepare`]. If it is cancelled during a long operation, hands over the state
    /// before it, so that the whole operation is repeated.
    pub(super) fn prepare_or_stop(
        &mut self,
        hooks: &mut TrainHooks<'_>,
        kept: &Kept,
    ) -> Result<(), ReconstructError> {
        let step = self.next;
        let takes_long = self.estimates_shake(step) || self.refines_poses(step);
        let is_newer = step > kept.step && hooks.checkpoint.is_some();
        let before = (takes_long && is_newer).then(|| self.checkpoint());
        let before = before.transpose()?;
        let prepared = self.prepare(step, hooks.cancel);
        if let (Err(ReconstructError::Cancelled(_)), Some(before)) = (&prepared, &before) {
            hand_over(hooks, before);
        }
        prepared
    }

    /// Runs the work between steps, in the order of its dependencies.
    fn prepare(&mut self, step: u32, cancel: &CancelToken) -> Result<(), ReconstructError> {
        let divisor = self.schedule.divisor(step);
        if divisor != self.divisor {
            self.set_level(divisor)?;
        }
        let degree = self.schedule.degree(step);
        if self.estimates_shake(step) {
            let begun = Instant::now();
            self.model.estimate_shake(&mut *self.scene, degree, cancel)?;
            self.seconds_between.kernels += begun.elapsed().as_secs_f64();
        }
        if self.refines_poses(step)
            && let Some(depth) = self.config.refine_poses
        {
            let begun = Instant::now();
            let how =
                Correction { depth, degree, is_coarse: !self.schedule.refines_poses_last(step) };
            self.model.refine_poses(&mut *self.scene, how, cancel)?;
            self.seconds_between.cameras += begun.elapsed().as_secs_f64();
        }
        if self.densifies(step) {
            let begun = Instant::now();
            self.densify(step)?;
            self.seconds_between.growth += begun.elapsed().as_secs_f64();
        }
        Ok(())
    }

    /// Changes the resolution.
    pub(super) fn set_level(&mut self, divisor: usize) -> Result<(), GpuError> {
        self.divisor = divisor;
        self.model.reduce(divisor);
        let sizes: Vec<_> = self.model.views.iter().map(Observed::size).collect();
        self.scene.set_sizes(&sizes)
    }

    fn estimates_shake(&self, step: u32) -> bool {
        self.config.shake.is_some() && self.schedule.estimates_shake(step)
    }

    fn refines_poses(&self, step: u32) -> bool {
        self.config.refine_poses.is_some() && self.schedule.refines_poses(step)
    }

    pub(super) fn check_finite(&self) -> Result<(), ReconstructError> {
        let dropped = u64::from(self.scene.non_finite()?);
        let updates = f64::from(self.schedule.steps) * self.scene.count() as f64;
        if dropped as f64 > NON_FINITE_LIMIT * updates {
            return Err(ReconstructError::NotFinite { dropped, step: self.next });
        }
        Ok(())
    }

    /// Inspects the noise map of the last step; warns once if it models the scene.
    pub(super) fn inspect_noise(&mut self) -> Result<(), GpuError> {
        let Some(seen) = self.scene.inspect_noise()? else {
            return Ok(());
        };
        if seen.follows_scene && self.warnings.is_empty() {
            let correlation = seen.correlation;
            self.warnings.push(format!(
                "the noise map follows the scene (correlation {correlation:.2}): the scene may lack \
                 what the map takes up; `noise=off` trains without it"
            ));
        }
        self.noise_seen.push(NoiseMapStatistics {
            mean: seen.mean,
            spread: seen.spread,
            correlation: seen.correlation.abs(),
        });
        Ok(())
    }

    pub(super) fn offer_checkpoint(
        &self,
        hooks: &mut TrainHooks<'_>,
        kept: &mut Kept,
    ) -> Result<(), ReconstructError> {
        if hooks.checkpoint.is_some() && kept.at.elapsed() >= self.checkpoint_every {
            hand_over(hooks, &self.checkpoint()?);
            *kept = Kept::now(self.next);
        }
        Ok(())
    }

    /// Hands over the state before step `next` if it is newer than the last checkpoint. All earlier
    /// steps are done; the work between steps is not.
    pub(super) fn stop(
        &self,
        hooks: &mut TrainHooks<'_>,
        kept: &Kept,
    ) -> Result<Cancelled, ReconstructError> {
        if self.next > kept.step && hooks.checkpoint.is_some() {
            hand_over(hooks, &self.checkpoint()?);
        }
        Ok(Cancelled)
    }
}

fn hand_over(hooks: &mut TrainHooks<'_>, checkpoint: &Checkpoint) {
    if let Some(hook) = &mut hooks.checkpoint {
        hook(checkpoint);
    }
}
