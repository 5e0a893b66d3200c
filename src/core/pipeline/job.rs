//! The state of one run, and the bookkeeping that every stage shares.

use std::collections::BTreeMap;
use std::time::Instant;

use super::Tools;
use super::config::Options;
use super::error::PipelineError;
use super::plan::Plan;
use super::views::working_size;
use super::workspace::{Workspace, fingerprint};
use crate::cancel::CancelToken;
use crate::capture::Capture;
use crate::deblur::DeblurInfo;
use crate::event::{Event, ProgressSink, Stage};
use crate::image::Image;
use crate::metrics::RoundMetrics;

/// One run of the pipeline.
pub struct Job<'a, 't> {
    pub(super) capture: &'a Capture,
    pub(super) options: &'a Options,
    pub(super) tools: &'a mut Tools<'t>,
    pub(super) workspace: &'a Workspace,
    pub(super) sink: &'a mut dyn ProgressSink,
    pub(super) cancel: &'a CancelToken,
    pub(super) plan: Plan,
    /// Wall seconds by stage, those of an earlier process included.
    pub(super) seconds: BTreeMap<Stage, f64>,
    pub(super) round_seconds: f64,
    pub(super) rounds: Vec<RoundMetrics>,
    pub(super) started: Instant,
    pub(super) poses_facts: BTreeMap<String, serde_json::Value>,
    /// Fingerprint of everything that the rounds depend on, set once the poses are known.
    pub(super) inputs: String,
    /// The views as the enhancing network brightened them, where there is one.
    pub(super) brightened: Option<Vec<Image>>,
}

impl<'a, 't> Job<'a, 't> {
    /// Prepares a run and writes the options as run.
    pub fn new(
        capture: &'a Capture,
        options: &'a Options,
        tools: &'a mut Tools<'t>,
        workspace: &'a Workspace,
        sink: &'a mut dyn ProgressSink,
        cancel: &'a CancelToken,
    ) -> Result<Self, PipelineError> {
        cancel.check()?;
        workspace.write_json(&workspace.path("config.json"), options)?;
        let views = capture.views.len();
        let pixels = capture.views.first().map_or(0, |view| {
            let (width, height) = working_size(view.width, view.height, options.size as usize);
            width * height
        });
        sink.event(&Event::Planned {
            rounds: options.rounds,
            views: views as u32,
        });
        let adapter = tools.gpu.describe();
        sink.log(format!("adapter: {adapter}"));
        for (use_of, network) in networks(tools) {
            sink.log(format!("{use_of}: {} on {}", network.id, network.provider));
        }
        let trained_on = if options.trains_on_enhanced() {
            "enhanced"
        } else {
            "deblurred"
        };
        sink.log(format!("the scene is trained on the {trained_on} views"));
        for fallback in &tools.fallbacks {
            sink.warn("fallback", fallback.clone());
        }
        Ok(Self {
            capture,
            options,
            tools,
            workspace,
            sink,
            cancel,
            plan: Plan::new(options, views, pixels),
            seconds: BTreeMap::new(),
            round_seconds: 0.0,
            rounds: Vec::new(),
            started: Instant::now(),
            poses_facts: BTreeMap::new(),
            inputs: String::new(),
            brightened: None,
        })
    }

    /// The networks of this run, by what they are for.
    pub(super) fn networks(&self) -> Vec<(&'static str, DeblurInfo)> {
        networks(self.tools)
    }

    /// Fingerprint of a stage of a round: the run's inputs and all rounds before are in it.
    pub(super) fn stage_fingerprint(&self, stage: Stage, round: u32) -> String {
        fingerprint(&[&self.inputs, stage.name(), &round.to_string()])
    }

    /// Runs `work` as a stage: events, seconds, progress.
    pub(super) fn stage<T>(
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

    /// Notes a stage that an earlier process had finished in `seconds`.
    pub(super) fn skip_stage(&mut self, stage: Stage, round: u32, seconds: f64) {
        self.sink.event(&Event::StageStarted { stage, round });
        self.end_stage(stage, round, seconds, true);
    }

    fn end_stage(&mut self, stage: Stage, round: u32, seconds: f64, skipped: bool) {
        *self.seconds.entry(stage).or_default() += seconds;
        if round > 0 {
            self.round_seconds += seconds;
        }
        self.sink.event(&Event::StageFinished {
            stage,
            round,
            seconds,
            skipped,
        });
        self.plan.finish(stage, skipped, self.sink);
    }

    /// Tells how far a stage of countable units is.
    pub(super) fn advance(&mut self, stage: Stage, round: u32, done: usize, total: usize) {
        self.sink.event(&Event::StageAdvanced {
            stage,
            round,
            done: done as u64,
            total: total as u64,
            steps_per_second: None,
        });
        self.plan
            .advance(stage, done as f64 / total.max(1) as f64, self.sink);
    }
}

fn networks(tools: &Tools<'_>) -> Vec<(&'static str, DeblurInfo)> {
    let mut networks = vec![("deblur", tools.deblurrer.describe())];
    networks.extend(
        tools
            .deblurrer
            .unguided()
            .map(|info| ("deblur_unguided", info)),
    );
    networks.extend(
        tools
            .enhancer
            .as_ref()
            .map(|enhancer| ("enhance", enhancer.describe())),
    );
    networks
}
