//! The loop over the steps of a round.

mod between;
mod population;
mod saved;
mod step;
mod stepper;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::forward_model::ForwardModel;
use super::look::Look;
use super::training::{self, Setup, Training};
use super::{
    Densify, ReconstructError, Schedule, Seen, TrainConfig, TrainHooks, TrainStart, Trained,
    TrainingView,
};
use crate::cancel::Cancelled;
use crate::device::Device;
use crate::gaussians::Gaussians;
use crate::metrics::report::{BetweenSteps, NoiseMapStatistics};
use crate::noise::NoiseMode;
use between::Kept;
pub use stepper::Stepper;

/// Steps in flight.
const IN_FLIGHT: usize = 2;
/// Time between checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(30);
/// Time between reports of progress.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// Steps between inspections of the noise map.
const INSPECT: u32 = 100;
/// Steps between reports of the state of training, at which nothing is in flight.
const REPORT_EVERY: u32 = 25;

/// The state of a round.
pub(super) struct Trainer<'a> {
    config: &'a TrainConfig,
    schedule: Schedule,
    model: ForwardModel<'a>,
    scene: Box<dyn Training>,
    /// 4, 2 or 1: the divisor of the images' size.
    divisor: usize,
    noise_seen: Vec<NoiseMapStatistics>,
    warnings: Vec<String>,
    next: u32,
    /// Steps to repeat, the next one first.
    again: VecDeque<u32>,
    start_count: usize,
    /// The steps submitted while nothing was in flight.
    #[cfg(test)]
    idle: Vec<u32>,
    /// Wall seconds of training in earlier processes.
    seconds_before: f64,
    /// Wall seconds between the steps, in this process.
    seconds_between: BetweenSteps,
    /// Start of training in this process.
    begun: Instant,
    checkpoint_every: Duration,
    progress_every: Duration,
}

impl<'a> Trainer<'a> {
    pub(super) fn new(
        device: &Device,
        views: &'a [TrainingView],
        start: TrainStart,
        config: &'a TrainConfig,
    ) -> Result<Self, ReconstructError> {
        let (gaussians, checkpoint) = match start {
            TrainStart::Fresh(gaussians) => (gaussians.with_sh_degree(config.sh_degree), None),
            TrainStart::Resume(checkpoint) => (checkpoint.state.gaussians(), Some(checkpoint)),
        };
        let model = ForwardModel::new(views, &gaussians, config.shake.as_ref())?;
        let schedule = config.schedule();
        let divisor = schedule.divisor(0);
        let scene = training::begin(device, &setup(views, &gaussians, config))?;
        let mut trainer = Self {
            scene,
            divisor,
            noise_seen: Vec::new(),
            warnings: Vec::new(),
            next: 0,
            again: VecDeque::new(),
            start_count: gaussians.len(),
            #[cfg(test)]
            idle: Vec::new(),
            seconds_before: 0.0,
            seconds_between: BetweenSteps::default(),
            begun: Instant::now(),
            checkpoint_every: CHECKPOINT_EVERY,
            progress_every: PROGRESS_EVERY,
            model,
            config,
            schedule,
        };
        trainer.set_level(divisor)?;
        if let Some(checkpoint) = checkpoint {
            trainer.restore(&checkpoint)?;
        }
        Ok(trainer)
    }

    pub(super) fn run(mut self, hooks: &mut TrainHooks<'_>) -> Result<Trained, ReconstructError> {
        self.begun = Instant::now();
        self.train_to(u32::MAX, hooks)?;
        self.finish()
    }

    /// Trains up to step `last`, or to the end of the round, and leaves nothing in flight. On
    /// cancellation, hands over a checkpoint after the running step or, if that step must be
    /// repeated, after the next step that need not be.
    fn train_to(&mut self, last: u32, hooks: &mut TrainHooks<'_>) -> Result<(), ReconstructError> {
        let begin = Instant::now();
        let first = self.next;
        let (mut reported, mut kept) = (begin, Kept::now(first));
        loop {
            let is_asked = hooks.cancel.is_cancelled();
            if is_asked && hooks.checkpoint.is_none() {
                return Err(Cancelled.into());
            }
            let end = self.next >= last.min(self.schedule.steps);
            if end || self.is_sync(self.next) {
                self.settle(0)?;
                if self.again.is_empty() {
                    self.check_finite()?;
                    if !end && self.next > first && self.next.is_multiple_of(INSPECT) {
                        self.inspect_noise()?;
                    }
                    if is_asked {
                        return Err(self.stop(hooks, &kept)?.into());
                    }
                    let begun = Instant::now();
                    if !end {
                        self.show(first, hooks)?;
                    }
                    self.look(first, hooks)?;
                    self.seconds_between.pictures += begun.elapsed().as_secs_f64();
                    if end {
                        return Ok(());
                    }
                    let begun = Instant::now();
                    self.offer_checkpoint(hooks, &mut kept)?;
                    self.seconds_between.checkpoints += begun.elapsed().as_secs_f64();
                    self.prepare_or_stop(hooks, &kept)?;
                }
            } else if is_asked && self.again.is_empty() && self.scene.is_done()? {
                return Err(self.stop(hooks, &kept)?.into());
            }
            let step = self.again.pop_front().unwrap_or_else(|| {
                self.next += 1;
                self.next - 1
            });
            #[cfg(test)]
            self.idle.extend((self.scene.in_flight() == 0).then_some(step));
            self.submit(step)?;
            self.settle(IN_FLIGHT - 1)?;
            if reported.elapsed() >= self.progress_every {
                reported = Instant::now();
                let rate = f64::from(self.next - first) / begin.elapsed().as_secs_f64();
                (hooks.progress)(u64::from(self.next), u64::from(self.schedule.steps), rate);
            }
        }
    }

    /// Reports the state of training to the hook, if any; nothing may be in flight.
    fn show(&self, first: u32, hooks: &mut TrainHooks<'_>) -> Result<(), ReconstructError> {
        let Some(seen) = &mut hooks.seen else {
            return Ok(());
        };
        if self.next > first && self.next.is_multiple_of(REPORT_EVERY) {
            let (step, steps) = (self.next, self.schedule.steps);
            seen(Seen { step, steps, loss: self.scene.loss()?, gaussians: self.scene.count() });
        }
        Ok(())
    }

    /// Calls the look hook, if any; nothing may be in flight.
    fn look(&mut self, first: u32, hooks: &mut TrainHooks<'_>) -> Result<(), ReconstructError> {
        let Some(look) = &mut hooks.look else {
            return Ok(());
        };
        if self.next > first {
            let seconds = self.seconds();
            let mut moment = Look {
                step: self.next,
                steps: self.schedule.steps,
                seconds,
                change: None,
                degree: self.schedule.degree(self.next - 1),
                scene: &mut *self.scene,
            };
            look(&mut moment)?;
            if let Some(steps) = moment.change.filter(|_| !moment.is_last()) {
                self.schedule.steps = steps.max(self.next + 1);
            }
        }
        Ok(())
    }

    /// Wall seconds of the round so far, in all processes.
    fn seconds(&self) -> f64 {
        self.seconds_before + self.begun.elapsed().as_secs_f64()
    }

    fn finish(self) -> Result<Trained, ReconstructError> {
        let state = self.scene.save()?;
        Ok(Trained {
            gaussians: state.gaussians().without_unusable(),
            steps: u64::from(self.schedule.steps),
            seconds: self.seconds(),
            between: self.seconds_between,
            non_finite_gradients: u64::from(state.non_finite),
            noise: mean_statistics(&self.noise_seen),
            expected_noise: self.model.expected_noise(),
            shake_px: self.model.mean_spread(),
            kernels: self.model.explained(),
            cameras: self.model.cameras(),
            final_loss: self.scene.loss()?,
            warnings: self.warnings,
        })
    }
}

#[cfg(test)]
impl Trainer<'_> {
    /// Trains to the first synchronisation at or after `step` and returns its checkpoint.
    pub(super) fn frozen_at(self, step: u32) -> super::Checkpoint {
        let mut frozen = None;
        let cancel = crate::cancel::CancelToken::new();
        let mut keep = |checkpoint: &super::Checkpoint| {
            if checkpoint.step >= step {
                frozen.get_or_insert_with(|| checkpoint.clone());
            }
        };
        let mut hooks = TrainHooks {
            cancel: &cancel,
            progress: &mut |_, _, _| {},
            checkpoint: Some(&mut keep),
            seen: None,
            look: None,
        };
        self.often_kept().run(&mut hooks).expect("trains");
        frozen.expect("a checkpoint after the step")
    }

    /// Trains until `step` steps are done, then cancels, from the look hook if `between`, else from
    /// the progress hook. Returns the checkpoints handed over.
    pub(super) fn stopped_at(mut self, step: u32, between: bool) -> Vec<super::Checkpoint> {
        let mut kept = Vec::new();
        let cancel = crate::cancel::CancelToken::new();
        self.progress_every = Duration::ZERO;
        let mut keep = |checkpoint: &super::Checkpoint| kept.push(checkpoint.clone());
        let mut hooks = TrainHooks {
            cancel: &cancel,
            progress: &mut |done, _, _| {
                if !between && done >= u64::from(step) {
                    cancel.cancel();
                }
            },
            checkpoint: Some(&mut keep),
            seen: None,
            look: Some(&mut |look| {
                if between && look.step >= step {
                    cancel.cancel();
                }
                Ok(())
            }),
        };
        let outcome = self.run(&mut hooks);
        assert!(matches!(outcome, Err(ReconstructError::Cancelled(_))), "it ended");
        kept
    }

    /// Trains up to `last` and returns the steps before which the device had nothing to do.
    pub(super) fn idle_before(mut self, last: u32) -> Vec<u32> {
        let cancel = crate::cancel::CancelToken::new();
        let mut hooks = TrainHooks {
            cancel: &cancel,
            progress: &mut |_, _, _| {},
            checkpoint: None,
            seen: None,
            look: None,
        };
        self.train_to(last, &mut hooks).expect("trains");
        self.idle
    }

    /// The trainer with a checkpoint whenever nothing is in flight.
    pub(super) fn often_kept(self) -> Self {
        Self { checkpoint_every: Duration::ZERO, ..self }
    }

    /// The trainer with room for this number of intersections.
    pub(super) fn with_intersections(mut self, intersections: usize) -> Self {
        let mut state = self.scene.save().expect("read");
        state.intersections = intersections as u32;
        self.restore_scene(&state).expect("made");
        self
    }
}

fn setup<'s>(
    views: &[TrainingView],
    gaussians: &'s Gaussians,
    config: &'s TrainConfig,
) -> Setup<'s> {
    let most = |side: fn(&TrainingView) -> usize| views.iter().map(side).max().unwrap_or(0);
    Setup {
        gaussians,
        capacity: config.cap.max(gaussians.len()),
        size: [most(|view| view.image.width()), most(|view| view.image.height())],
        views: views.len(),
        shake: config.shake.as_ref(),
        noise: (config.noise == NoiseMode::Paper).then_some(config.seed),
        accumulates: config.densify == Densify::Classic,
    }
}

fn mean_statistics(seen: &[NoiseMapStatistics]) -> Option<NoiseMapStatistics> {
    let mean = |value: fn(&NoiseMapStatistics) -> f64| {
        seen.iter().map(value).sum::<f64>() / seen.len() as f64
    };
    let correlation = seen.iter().map(|s| s.correlation).fold(0.0, f64::max);
    (!seen.is_empty()).then(|| NoiseMapStatistics {
        mean: mean(|s| s.mean),
        spread: mean(|s| s.spread),
        correlation,
    })
}
