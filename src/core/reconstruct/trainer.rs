//! The loop over the steps of a round.

mod colours;
mod population;
mod poses;
mod saved;
mod shaken;
mod stepper;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use fled_gpu::{Buffer, Gpu, GpuError, Recording};
use rand::RngExt;

use super::colour::ViewColour;
use super::level::Level;
use super::optimizer::{Optimizer, SlotGradients, StepUniform};
use super::{
    Background, Densify, ReconstructError, Schedule, TrainConfig, TrainHooks, TrainStart, Trained,
    TrainingView,
};
use crate::cancel::CancelToken;
use crate::metrics::report::NoiseMapStatistics;
use crate::noise::{NoiseField, NoiseMode, OFF_SHARE, Room};
use crate::register::Motion;
use crate::shake::Shake;
use crate::splat::project::{DeviceGaussians, Projection};
use crate::splat::rasterize::{
    Backward, Forward, PendingCounts, SlotRows, Specialisation, SplatBuffers, SplatSizes,
};
use crate::splat::uniform::{CameraUniform, NEAR};
pub use stepper::Stepper;

/// Every so many steps the device is left to finish. What depends on finished steps (growing
/// buffers, checkpoints) happens there alone, so that an interruption changes nothing.
const SYNC: u32 = 25;
/// Steps in flight.
const IN_FLIGHT: usize = 2;
/// Time between checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(30);
/// Time between reports of progress.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// Steps between looks at the noise map.
const INSPECT: u32 = 100;
/// A warm round does not grow before this share of its steps.
const WARM_GROWTH: f64 = 0.05;
/// A round fails when more than this share of all Gaussians' updates was not finite.
const NON_FINITE_LIMIT: f64 = 1e-3;

/// Steps whose count of intersections is not known yet, and those that must be repeated.
#[derive(Default)]
struct Flight {
    pending: VecDeque<(u32, PendingCounts)>,
    redo: VecDeque<u32>,
}

/// Everything a round holds.
pub(super) struct Trainer<'a> {
    gpu: &'a Gpu,
    views: &'a [TrainingView],
    config: &'a TrainConfig,
    schedule: Schedule,
    gaussians: DeviceGaussians,
    projection: Projection,
    optimizer: Optimizer,
    raster: SplatBuffers,
    specialisation: Specialisation,
    prediction: Buffer<f32>,
    gradient: Buffer<f32>,
    level: Level,
    /// A step of each view without the noise field, kept while buffers and level stay.
    recordings: Vec<Option<Recording>>,
    noise: Option<NoiseField>,
    noise_seen: Vec<NoiseMapStatistics>,
    shake: Option<Shake>,
    /// Where each view was taken from, relative to the pose it came with.
    motions: Vec<Motion>,
    /// Exposure and cast of each view.
    colours: Vec<ViewColour>,
    warnings: Vec<String>,
    next: u32,
    start_count: usize,
    last_view: usize,
    checkpoint_every: Duration,
}

impl<'a> Trainer<'a> {
    pub(super) fn new(
        gpu: &'a Gpu,
        views: &'a [TrainingView],
        start: TrainStart,
        config: &'a TrainConfig,
    ) -> Result<Self, ReconstructError> {
        let (gaussians, checkpoint) = match start {
            TrainStart::Fresh(gaussians) => (gaussians.with_sh_degree(config.sh_degree), None),
            TrainStart::Resume(checkpoint) => (saved::scene_of(&checkpoint), Some(checkpoint)),
        };
        if views.is_empty() || gaussians.is_empty() {
            return Err(ReconstructError::Empty {
                views: views.len(),
                gaussians: gaussians.len(),
            });
        }
        let grows = config.densify != Densify::Off;
        let capacity = if grows { config.cap } else { 0 }.max(gaussians.len());
        let device = DeviceGaussians::upload(gpu, &gaussians, capacity)?;
        let size = largest(views);
        let sizes = SplatSizes {
            gaussians: capacity,
            width: size[0],
            height: size[1],
            intersections: (4 * capacity + 16 * 1024).min(SlotRows::most(gpu)),
        };
        let schedule = config.schedule();
        let mut trainer = Self {
            optimizer: Optimizer::new(gpu, &device, config.densify == Densify::Classic)?,
            projection: Projection::new(gpu, capacity)?,
            raster: SplatBuffers::new(gpu, sizes, true)?,
            specialisation: Specialisation::for_adapter(gpu.describe()),
            prediction: gpu.create("prediction", 3 * size[0] * size[1])?,
            gradient: gpu.create("image gradient", 3 * size[0] * size[1])?,
            level: Level::new(gpu, views, schedule.divisor(0))?,
            colours: vec![ViewColour::default(); views.len()],
            recordings: Vec::new(),
            noise: NoiseField::new(gpu, config.noise, config.seed, size)?,
            noise_seen: Vec::new(),
            shake: config
                .shake
                .as_ref()
                .map(|r| Shake::new(gpu, views.len(), size, r))
                .transpose()?,
            motions: vec![Motion::default(); views.len()],
            warnings: Vec::new(),
            next: 0,
            start_count: gaussians.len(),
            last_view: 0,
            checkpoint_every: CHECKPOINT_EVERY,
            gaussians: device,
            gpu,
            views,
            config,
            schedule,
        };
        trainer.still_views()?;
        if let Some(checkpoint) = checkpoint {
            trainer.restore(&checkpoint)?;
        }
        trainer.forget_recordings();
        Ok(trainer)
    }

    /// Trains to the last step.
    pub(super) fn run(mut self, hooks: &mut TrainHooks<'_>) -> Result<Trained, ReconstructError> {
        let begin = Instant::now();
        self.train_to(self.config.steps, hooks)?;
        self.finish(begin)
    }

    /// Trains up to the step `last`, at most the round's number, and leaves nothing in flight.
    fn train_to(&mut self, last: u32, hooks: &mut TrainHooks<'_>) -> Result<(), ReconstructError> {
        let begin = Instant::now();
        let first = self.next;
        let (mut told, mut saved) = (begin, begin);
        let mut flight = Flight::default();
        let mut prepared = false;
        loop {
            hooks.cancel.check()?;
            let end = self.next == last;
            if end || (!prepared && self.is_sync(self.next)) {
                self.settle(&mut flight, 0)?;
                if flight.redo.is_empty() {
                    self.check_finite()?;
                    if end {
                        return Ok(());
                    }
                    if self.next > first && self.next.is_multiple_of(INSPECT) {
                        self.inspect_noise()?;
                    }
                    self.offer_checkpoint(hooks, &mut saved)?;
                    self.prepare(self.next, hooks.cancel)?;
                    prepared = true;
                }
            }
            let step = flight.redo.pop_front().unwrap_or_else(|| {
                prepared = false;
                self.next += 1;
                self.next - 1
            });
            self.submit(step)?;
            flight.pending.push_back((step, self.raster.counts()?));
            self.settle(&mut flight, IN_FLIGHT - 1)?;
            if told.elapsed() >= PROGRESS_EVERY {
                told = Instant::now();
                let rate = f64::from(self.next - first) / begin.elapsed().as_secs_f64();
                (hooks.progress)(u64::from(self.next), u64::from(self.config.steps), rate);
            }
        }
    }

    fn finish(self, begin: Instant) -> Result<Trained, ReconstructError> {
        let final_loss = self.level.loss(self.last_view).value()?.total;
        Ok(Trained {
            gaussians: self.gaussians.download()?.without_unusable(),
            steps: u64::from(self.config.steps),
            seconds: begin.elapsed().as_secs_f64(),
            non_finite_gradients: u64::from(self.optimizer.counters.read()?[0]),
            noise: mean_statistics(&self.noise_seen),
            shake_px: self.shake.as_ref().map(Shake::mean_spread),
            cameras: self.cameras(),
            warnings: self.warnings,
            final_loss,
        })
    }

    fn is_sync(&self, step: u32) -> bool {
        let divisor = self.schedule.divisor(step);
        step.is_multiple_of(SYNC)
            || self.densifies(step)
            || self.estimates_shake(step)
            || self.refines_poses(step)
            || self.matches_colours(step)
            || divisor != self.level.divisor
    }

    /// What happens between steps: another resolution, densification.
    fn prepare(&mut self, step: u32, cancel: &CancelToken) -> Result<(), ReconstructError> {
        let divisor = self.schedule.divisor(step);
        if divisor != self.level.divisor {
            self.level = Level::new(self.gpu, self.views, divisor)?;
            self.place_cameras();
            self.show_colours()?;
            self.still_views()?;
            self.forget_recordings();
        }
        if self.matches_colours(step) {
            self.match_colours(step, cancel)?;
        }
        if self.estimates_shake(step) {
            self.estimate_shake(step, cancel)?;
        }
        if self.refines_poses(step) {
            self.refine_poses(step, cancel)?;
        }
        if self.densifies(step) {
            self.densify(step)?;
        }
        Ok(())
    }

    /// Hands one step to the device.
    fn submit(&mut self, step: u32) -> Result<(), GpuError> {
        let index = self.schedule.view(step, self.views.len());
        let (schedule, extent) = (&self.schedule, self.config.extent);
        let view = &self.level.views[index];
        let count = self.gaussians.count;
        let (degree, allocated) = (schedule.degree(step), self.gaussians.sh_degree);
        // The near plane of the renderer: a splat that training culls would be a floater in the
        // views.
        let camera = CameraUniform::new(&view.camera, count, degree, allocated, NEAR)
            .before(self.background(step))
            .dropping(
                self.schedule.share(step) as f32 * self.config.dropout as f32,
                self.schedule.generator(4, u64::from(step)).random(),
            );
        let mut numbers = StepUniform::new(
            schedule,
            step,
            count,
            extent,
            self.config.densify == Densify::Mcmc,
        );
        let (_, total_at) = self.raster.totals();
        numbers.capacity = self.raster.sizes().intersections as u32;
        numbers.total_at = total_at;
        self.projection.camera.write(&[camera])?;
        self.optimizer.step.write(&[numbers])?;
        self.last_view = index;
        if self.noise_acts(step) {
            return self.record(index, true)?.submit().map(|_| ());
        }
        if self.recordings[index].is_none() {
            self.recordings[index] = Some(self.record(index, false)?);
        }
        match &self.recordings[index] {
            Some(recording) => recording.submit().map(|_| ()),
            None => Ok(()),
        }
    }

    fn background(&self, step: u32) -> [f32; 3] {
        match self.config.background {
            Background::Black => [0.0; 3],
            Background::Random => self.schedule.generator(3, u64::from(step)).random(),
        }
    }

    fn noise_acts(&self, step: u32) -> bool {
        let late = self.schedule.share(step) >= OFF_SHARE;
        self.noise.is_some() && (self.config.noise == NoiseMode::Paper || late)
    }

    fn record(&mut self, index: usize, noisy: bool) -> Result<Recording, GpuError> {
        let mut recorder = self.gpu.recorder();
        let view = &self.level.views[index];
        self.projection.record(&mut recorder, &self.gaussians)?;
        Forward::new(self.specialisation).record(&mut recorder, &self.projection, &self.raster)?;
        let loss = self.level.loss(index);
        let mut clean = &self.raster.image;
        if let Some(shake) = &self.shake {
            shake.record_forward(&mut recorder, index, &self.raster.image)?;
            clean = shake.blurred();
        }
        match &mut self.noise {
            Some(noise) if noisy => {
                noise.begin_step(&view.camera, self.views[index].noise_sigma)?;
                noise.record_forward(&mut recorder, clean, &self.prediction)?;
                loss.record(
                    &mut recorder,
                    &self.prediction,
                    &view.target,
                    &self.gradient,
                )?;
                let (intersections, total_at) = self.raster.totals();
                let capacity = self.raster.sizes().intersections as u32;
                noise.record_backward(
                    &mut recorder,
                    &self.gradient,
                    &Room {
                        intersections,
                        total_at,
                        capacity,
                    },
                )?;
            }
            _ => loss.record(&mut recorder, clean, &view.target, &self.gradient)?,
        }
        let mut by_render = &self.gradient;
        if let Some(shake) = &self.shake {
            shake.record_backward(&mut recorder, index, &self.raster.image, &self.gradient)?;
            by_render = shake.render_gradient();
        }
        let backward = Backward::new(self.specialisation);
        backward.record(&mut recorder, &self.projection, &self.raster, by_render)?;
        let slots = SlotGradients {
            slot_offsets: &self.raster.slot_offsets,
            rows: &self.raster.slots,
            totals: self.raster.totals().0,
        };
        self.optimizer
            .record(&mut recorder, &self.gaussians, &self.projection, &slots)?;
        Ok(recorder.finish())
    }

    /// Waits until at most `left` steps are in flight. A step whose intersections did not fit has
    /// changed nothing: it is repeated in larger buffers.
    fn settle(&mut self, flight: &mut Flight, left: usize) -> Result<(), GpuError> {
        while flight.pending.len() > left {
            let Some((step, counts)) = flight.pending.pop_front() else {
                break;
            };
            let counts = counts.wait()?;
            if counts.overflowed() {
                flight.redo.push_back(step);
                if self.noise_acts(step)
                    && let Some(noise) = &mut self.noise
                {
                    noise.take_back_step();
                }
                self.grow_raster(counts.intersections)?;
            }
        }
        Ok(())
    }

    fn grow_raster(&mut self, needed: usize) -> Result<(), GpuError> {
        let sizes = self.raster.sizes();
        if needed <= sizes.intersections {
            return Ok(());
        }
        let wanted = (sizes.intersections * 3 / 2).max(needed + needed / 10);
        let intersections = wanted.min(SlotRows::most(self.gpu)).max(needed);
        self.raster = SplatBuffers::new(
            self.gpu,
            SplatSizes {
                intersections,
                ..sizes
            },
            true,
        )?;
        self.forget_recordings();
        Ok(())
    }

    fn forget_recordings(&mut self) {
        self.recordings = self.views.iter().map(|_| None).collect();
    }

    fn check_finite(&self) -> Result<(), ReconstructError> {
        let dropped = u64::from(self.optimizer.counters.read()?[0]);
        let updates = f64::from(self.config.steps) * self.gaussians.count as f64;
        if dropped as f64 > NON_FINITE_LIMIT * updates {
            return Err(ReconstructError::NotFinite {
                dropped,
                step: self.next,
            });
        }
        Ok(())
    }

    /// Looks at the noise map of the last step, before the checkpoint: the guard's verdict belongs
    /// to it.
    fn inspect_noise(&mut self) -> Result<(), GpuError> {
        let acts = self.noise_acts(self.next - 1);
        let Some(noise) = self.noise.as_mut().filter(|_| acts) else {
            return Ok(());
        };
        let clean = self
            .shake
            .as_ref()
            .map_or(&self.raster.image, Shake::blurred);
        let seen = noise.inspect(clean, &self.prediction)?;
        if seen.halved {
            let correlation = seen.correlation;
            self.warnings.push(format!(
                "noise map follows the scene ({correlation:.2}): bound halved"
            ));
        }
        self.noise_seen.push(NoiseMapStatistics {
            mean: seen.mean,
            spread: seen.spread,
            correlation: seen.correlation.abs(),
        });
        Ok(())
    }

    fn offer_checkpoint(
        &self,
        hooks: &mut TrainHooks<'_>,
        saved: &mut Instant,
    ) -> Result<(), ReconstructError> {
        if let Some(hook) = &mut hooks.checkpoint
            && saved.elapsed() >= self.checkpoint_every
        {
            hook(&self.checkpoint()?);
            *saved = Instant::now();
        }
        Ok(())
    }
}

#[cfg(test)]
impl Trainer<'_> {
    /// Trains to the first synchronisation at or after `step` and returns its checkpoint.
    pub(super) fn frozen_at(mut self, step: u32) -> super::Checkpoint {
        let mut frozen = None;
        let cancel = CancelToken::new();
        self.checkpoint_every = Duration::ZERO;
        let mut keep = |checkpoint: &super::Checkpoint| {
            if checkpoint.step >= step {
                frozen.get_or_insert_with(|| checkpoint.clone());
            }
        };
        let mut hooks = TrainHooks {
            cancel: &cancel,
            progress: &mut |_, _, _| {},
            checkpoint: Some(&mut keep),
        };
        self.run(&mut hooks).expect("trains");
        frozen.expect("a checkpoint after the step")
    }

    /// The same with room for so many intersections.
    pub(super) fn with_intersections(mut self, intersections: usize) -> Self {
        let sizes = self.raster.sizes();
        self.raster = SplatBuffers::new(
            self.gpu,
            SplatSizes {
                intersections,
                ..sizes
            },
            true,
        )
        .expect("made");
        self.forget_recordings();
        self
    }
}

/// Largest width and height.
fn largest(views: &[TrainingView]) -> [usize; 2] {
    let most = |side: fn(&TrainingView) -> usize| views.iter().map(side).max().unwrap_or(0);
    [most(|v| v.image.width()), most(|v| v.image.height())]
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
