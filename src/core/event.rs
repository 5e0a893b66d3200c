//! What the pipeline tells whoever watches: typed events, pushed into a sink.
//!
//! The same types, one JSON object a line, are the protocol between a job's child process and
//! the service.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::metrics::RoundMetrics;

/// The stages of a job, in the order in which Algorithm 1 meets them.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Structure from motion, once a job.
    Poses,
    /// Tone curves from the dark originals to each round's brightness.
    Enhance,
    /// The deblurring network.
    Deblur,
    /// Training the noise-aware splats.
    Reconstruct,
    /// Rendering the scene at the cameras of the views.
    Render,
    /// Fitting the curve that maps renders to the next brightness.
    Match,
    /// Metrics of the round.
    Evaluate,
}

impl Stage {
    /// Every stage in order.
    pub const ALL: [Self; 7] = [
        Self::Poses,
        Self::Enhance,
        Self::Deblur,
        Self::Reconstruct,
        Self::Render,
        Self::Match,
        Self::Evaluate,
    ];

    /// The name used in JSON, logs and SQL.
    pub fn name(self) -> &'static str {
        match self {
            Self::Poses => "poses",
            Self::Enhance => "enhance",
            Self::Deblur => "deblur",
            Self::Reconstruct => "reconstruct",
            Self::Render => "render",
            Self::Match => "match",
            Self::Evaluate => "evaluate",
        }
    }
}

/// One thing worth telling. Serialised with a tag: `{"event":"stage_started",...}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The run has read its capture and knows its plan.
    Planned {
        /// Rounds that will be run.
        rounds: u32,
        /// Accepted views.
        views: u32,
    },
    /// A stage begins. `round` is 1-based; 0 for [`Stage::Poses`].
    StageStarted {
        /// Which stage.
        stage: Stage,
        /// Which round.
        round: u32,
    },
    /// Progress inside a stage.
    StageAdvanced {
        /// Which stage.
        stage: Stage,
        /// Which round.
        round: u32,
        /// Units done (training steps, views, ladder rungs).
        done: u64,
        /// Units in all.
        total: u64,
        /// Training steps per second, where the stage counts steps.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        steps_per_second: Option<f64>,
    },
    /// How the training of a round goes, every 25 steps.
    TrainingSeen {
        /// Which round.
        round: u32,
        /// Steps done.
        step: u32,
        /// Steps in all.
        steps: u32,
        /// The loss of the last step's view: views differ, so it scatters about its course.
        loss: f64,
        /// Gaussians of the scene.
        gaussians: u64,
    },
    /// How well the scene that trains meets views that were held out from it, every 100 steps or
    /// more rarely, and after the last. Nothing is told where none is held out.
    HeldOutSeen {
        /// Which round.
        round: u32,
        /// Steps done.
        step: u32,
        /// Steps in all.
        steps: u32,
        /// Mean PSNR after an affine colour fit, dB, at half the size.
        psnr_cc_db: f64,
        /// Mean SSIM, at half the size.
        ssim: f64,
        /// Views that were compared.
        views: u32,
        /// Whether with ground truth. Else each render, shaken as its photograph is, with the view
        /// that was enhanced from that photograph: self-consistency.
        truth: bool,
    },
    /// There is a new picture of the scene that trains, about every ten seconds.
    ViewSeen {
        /// Which round.
        round: u32,
        /// Steps done.
        step: u32,
        /// From whose camera it is rendered.
        view: String,
        /// Whether that view was held out; else it trains.
        held_out: bool,
    },
    /// A stage ended well. `skipped`: an earlier run had finished it.
    StageFinished {
        /// Which stage.
        stage: Stage,
        /// Which round.
        round: u32,
        /// Wall seconds.
        seconds: f64,
        /// Whether its result was found on disk.
        skipped: bool,
    },
    /// A round's metrics are complete and stored.
    RoundFinished {
        /// The row of `metrics.json`.
        metrics: Box<RoundMetrics>,
    },
    /// Progress of the whole run, between 0 and 1, with an estimate of what is left.
    Progress {
        /// Share of the expected work that is done.
        progress: f64,
        /// Estimated seconds left; absent before there is anything to base it on.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        eta_seconds: Option<f64>,
    },
    /// Something the user should know; the run goes on.
    Warning {
        /// Stable snake_case code.
        code: String,
        /// One sentence, with figures.
        message: String,
    },
    /// A line for the log.
    Log {
        /// The line.
        message: String,
    },
    /// The run ended well. Last event of a stream.
    Finished {
        /// The delivered round.
        best_round: u32,
        /// Wall seconds of this process.
        seconds: f64,
    },
    /// The run failed. Last event of a stream.
    Failed {
        /// One of [`crate::pipeline::error::ErrorKind`]'s names.
        kind: String,
        /// What happened.
        detail: String,
        /// What to do about it.
        hint: String,
    },
}

impl Event {
    /// `done` of `total` units of a stage before the rounds.
    pub fn advanced(stage: Stage, done: u64, total: u64) -> Self {
        Self::StageAdvanced {
            stage,
            round: 0,
            done,
            total,
            steps_per_second: None,
        }
    }
}

/// Receives events. Implementations must not block for long.
pub trait ProgressSink {
    /// Takes one event.
    fn event(&mut self, event: &Event);

    /// Convenience: a [`Event::Warning`].
    fn warn(&mut self, code: &str, message: String) {
        self.event(&Event::Warning {
            code: code.to_owned(),
            message,
        });
    }

    /// Convenience: a [`Event::Log`].
    fn log(&mut self, message: String) {
        self.event(&Event::Log { message });
    }
}

impl<F: FnMut(&Event)> ProgressSink for F {
    fn event(&mut self, event: &Event) {
        self(event);
    }
}

/// A sink that forgets everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl ProgressSink for Silent {
    fn event(&mut self, _event: &Event) {}
}
