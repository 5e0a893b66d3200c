//! What all stages share: where results lie, whom to tell, when to stop, how long things take.

use std::collections::BTreeMap;
use std::time::Instant;

use super::dependencies::Dependencies;
use super::error::PipelineError;
use super::workspace::Workspace;
use crate::cancel::CancelToken;
use crate::event::{Event, ProgressSink, Stage};

/// The surroundings of one run.
pub struct Context<'a> {
    /// Where results lie.
    pub workspace: &'a Workspace,
    /// Whom to tell.
    pub sink: &'a mut dyn ProgressSink,
    /// When to stop.
    pub cancel: &'a CancelToken,
    /// What has taken how long.
    pub clock: Clock,
}

/// Wall seconds of the run, those of an earlier process included.
#[derive(Clone, Debug)]
pub struct Clock {
    started: Instant,
    stages: BTreeMap<Stage, f64>,
    rounds: BTreeMap<u32, f64>,
}

impl Clock {
    fn add(&mut self, stage: Stage, round: u32, seconds: f64) {
        *self.stages.entry(stage).or_default() += seconds;
        *self.rounds.entry(round).or_default() += seconds;
    }

    /// Seconds by stage, over all rounds.
    pub fn stages(&self) -> &BTreeMap<Stage, f64> {
        &self.stages
    }

    /// Seconds of all stages of a round so far.
    pub fn round(&self, round: u32) -> f64 {
        self.rounds.get(&round).copied().unwrap_or_default()
    }

    /// Seconds since this process began with the run.
    pub fn elapsed(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}

impl<'a> Context<'a> {
    /// The surroundings of a run that begins now.
    pub fn new(
        workspace: &'a Workspace,
        sink: &'a mut dyn ProgressSink,
        cancel: &'a CancelToken,
    ) -> Self {
        let clock =
            Clock { started: Instant::now(), stages: BTreeMap::new(), rounds: BTreeMap::new() };
        Self { workspace, sink, cancel, clock }
    }

    /// The only rule of resuming: what `make` leaves in the workspace serves until something that
    /// it depends on has changed; then, or when `load` cannot read it, it is made anew.
    ///
    /// # Errors
    /// Those of `make`; [`PipelineError::Io`] when the stamp cannot be written.
    pub fn once<T>(
        &mut self,
        stage: Stage,
        round: u32,
        depends_on: &Dependencies,
        load: impl FnOnce(&Workspace) -> Option<T>,
        make: impl FnOnce(&mut Self) -> Result<T, PipelineError>,
    ) -> Result<T, PipelineError> {
        let name = stamp_name(stage, round);
        let finished = self.workspace.finished(&name, depends_on.fingerprint());
        if let Some(seconds) = finished
            && let Some(value) = load(self.workspace)
        {
            self.sink.event(&Event::StageStarted { stage, round });
            self.end_stage(stage, round, seconds, true);
            return Ok(value);
        }
        // Else an interrupted `make` leaves a mixture under the stamp of an earlier one.
        self.workspace.unstamp(&name)?;
        let started = Instant::now();
        let value = self.stage(stage, round, make)?;
        let seconds = started.elapsed().as_secs_f64();
        self.workspace.stamp(&name, depends_on.fingerprint(), seconds)?;
        Ok(value)
    }

    /// Runs `work` as a stage: events, seconds, progress.
    ///
    /// # Errors
    /// Those of `work`, and [`PipelineError::Cancelled`] before it begins.
    pub fn stage<T>(
        &mut self,
        stage: Stage,
        round: u32,
        work: impl FnOnce(&mut Self) -> Result<T, PipelineError>,
    ) -> Result<T, PipelineError> {
        self.cancel.check()?;
        self.sink.event(&Event::StageStarted { stage, round });
        let started = Instant::now();
        let value = work(self)?;
        self.end_stage(stage, round, started.elapsed().as_secs_f64(), false);
        Ok(value)
    }

    fn end_stage(&mut self, stage: Stage, round: u32, seconds: f64, skipped: bool) {
        self.clock.add(stage, round, seconds);
        self.sink.event(&Event::StageFinished { stage, round, seconds, skipped });
    }

    /// Tells how far a stage of countable units is.
    pub fn advance(&mut self, stage: Stage, round: u32, progress: Advance) {
        let Advance { done, total, per_second } = progress;
        self.sink.event(&Event::StageAdvanced {
            stage,
            round,
            done,
            total,
            steps_per_second: per_second,
        });
    }
}

/// How far a stage is.
#[derive(Clone, Copy, Debug)]
pub struct Advance {
    /// Units done.
    pub done: u64,
    /// All units.
    pub total: u64,
    /// Optimiser steps a second, of training.
    pub per_second: Option<f64>,
}

impl Advance {
    /// `done` of `total` views.
    pub fn views(done: usize, total: usize) -> Self {
        Self { done: done as u64, total: total as u64, per_second: None }
    }
}

/// The stamp of a stage; stages before the rounds have the round 0.
pub fn stamp_name(stage: Stage, round: u32) -> String {
    format!("{}-{round}", stage.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Silent;
    use crate::pipeline::config::{Options, Setting};

    /// Asks for a stage's value as a run would, and counts how often it was made.
    fn ask(workspace: &Workspace, options: &Options, kept: bool, made: &mut u32) -> u32 {
        let (cancel, mut sink) = (CancelToken::new(), Silent);
        let mut context = Context::new(workspace, &mut sink, &cancel);
        let depends_on = Dependencies::on(options, &["cap"], &[]);
        let file = workspace.folder().root().join("value.json");
        let value = context.once(
            Stage::Deblur,
            1,
            &depends_on,
            |workspace| workspace.read_json(&file).filter(|_| kept),
            |context| {
                *made += 1;
                let value = depends_on.options().most_gaussians();
                context.workspace.write_json(&file, &value)?;
                Ok(value)
            },
        );
        value.expect("made or loaded")
    }

    #[test]
    fn a_stage_is_made_once_and_again_when_it_changes_or_cannot_be_read() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        let (small, mut made) = (Options::default(), 0);
        let large = Options { cap: Setting::Given(777), ..small.clone() };
        let slower = Options { steps: Setting::Given(77), ..small.clone() };
        let (few, many) = (small.most_gaussians(), large.most_gaussians());
        assert_eq!(ask(&workspace, &small, true, &mut made), few);
        assert_eq!(ask(&workspace, &slower, true, &mut made), few);
        assert_eq!(made, 1, "the number of steps is none of its options");
        assert_eq!(ask(&workspace, &large, true, &mut made), many);
        assert_eq!(made, 2);
        assert_eq!(ask(&workspace, &large, false, &mut made), many);
        assert_eq!(made, 3, "what cannot be read is made anew");
    }

    #[test]
    fn what_an_interrupted_stage_wrote_over_is_not_trusted_by_the_earlier_stamp() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        let (small, mut made) = (Options::default(), 0);
        ask(&workspace, &small, true, &mut made);
        let (cancel, mut sink) = (CancelToken::new(), Silent);
        let mut context = Context::new(&workspace, &mut sink, &cancel);
        let other = Dependencies::on(&small, &["steps"], &[]);
        let interrupted = context.once(
            Stage::Deblur,
            1,
            &other,
            |_| None::<u32>,
            |_| Err(crate::cancel::Cancelled.into()),
        );
        assert!(interrupted.is_err());
        ask(&workspace, &small, true, &mut made);
        assert_eq!(made, 2, "the file may be half of each");
    }

    #[test]
    fn the_clock_adds_up_stages_and_rounds() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let workspace = Workspace::open(folder.path()).expect("open");
        let (cancel, mut sink) = (CancelToken::new(), Silent);
        let mut context = Context::new(&workspace, &mut sink, &cancel);
        context.end_stage(Stage::Poses, 0, 1.0, false);
        context.end_stage(Stage::Deblur, 1, 2.0, true);
        context.end_stage(Stage::Render, 1, 4.0, false);
        context.end_stage(Stage::Deblur, 2, 8.0, false);
        assert_eq!(context.clock.stages()[&Stage::Deblur], 10.0);
        assert_eq!((context.clock.round(1), context.clock.round(2)), (6.0, 8.0));
    }
}
