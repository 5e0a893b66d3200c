//! Typed events that the pipeline pushes into a sink.
//!
//! The same types, one JSON object per line, are the protocol between a job's child process and the
//! service.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::metrics::{CaptureShake, ChosenDetail, RoundMetrics};
use crate::poses::overlap::Overlap;

/// The stages of a job, in the order of Algorithm 1.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Structure from motion before the rounds, and the search for late views after each.
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

/// An event of a run. Serialised with a tag: `{"event":"stage_started",...}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The run has read its capture and knows its plan, or has changed it.
    Planned {
        /// Number of rounds to run.
        rounds: u32,
        /// Number of accepted views; of those with a pose, once there are poses.
        views: u32,
        /// The verdict on the shake, once it is known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        shake: Option<CaptureShake>,
        /// Longest side of the working images, px, once it is known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        size: Option<u32>,
        /// Training steps of a round, once they are known.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        steps: Option<u32>,
    },
    /// The device has decided how much detail the run trains.
    DetailChosen {
        /// The decision.
        #[serde(flatten)]
        detail: ChosenDetail,
    },
    /// A stage begins. `round` is 1-based; 0 before the rounds.
    StageStarted {
        /// The stage.
        stage: Stage,
        /// Its round.
        round: u32,
    },
    /// The search for poses tries a strategy; those before it were not good enough, or the usual
    /// ones are compared.
    StrategyStarted {
        /// Its letter, as in `poses.json`.
        strategy: char,
        /// Its description, for users.
        name: String,
    },
    /// Too few poses were found, and not all photographs clearly show the same things.
    OverlapFound(Overlap),
    /// Progress inside a stage.
    StageAdvanced {
        stage: Stage,
        round: u32,
        /// Units done (training steps, views, fallback strategies).
        done: u64,
        /// Total units.
        total: u64,
        /// Training steps per second, if the stage counts steps.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        steps_per_second: Option<f64>,
    },
    /// The state of a round's training, every 25 steps; every 100 of a round of 5,000 and more.
    TrainingSeen {
        round: u32,
        /// Steps done.
        step: u32,
        /// Total steps.
        steps: u32,
        /// Loss of the last step's view; it scatters, because views differ.
        loss: f64,
        /// Number of Gaussians in the scene.
        gaussians: u64,
    },
    /// The fit of the scene in training to held-out views, every 100 steps or less often, and after
    /// the last. Not sent without held-out views.
    HeldOutSeen {
        round: u32,
        /// Steps done.
        step: u32,
        /// Total steps.
        steps: u32,
        /// Mean PSNR after an affine colour fit, dB, at half the size.
        psnr_cc_db: f64,
        /// Mean SSIM, at half the size.
        ssim: f64,
        /// Number of compared views.
        views: u32,
        /// Whether the references are ground truth. Else each render, shaken as its photograph is,
        /// is compared with the enhanced view: self-consistency.
        truth: bool,
    },
    /// A new picture of the scene in training exists, about every ten seconds.
    ViewSeen {
        round: u32,
        /// Steps done.
        step: u32,
        /// The view whose camera is rendered.
        view: String,
        /// Whether that view is held out; else it trains.
        held_out: bool,
    },
    /// A stage succeeded. `skipped`: an earlier run had finished it.
    StageFinished {
        stage: Stage,
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
    /// Progress of the whole run, between 0 and 1, with an estimate of the remaining time.
    Progress {
        /// Share of the expected work that is done.
        progress: f64,
        /// Estimated seconds left; absent while there is no basis for an estimate.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        eta_seconds: Option<f64>,
    },
    /// A warning for the user; the run continues.
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
    /// The run succeeded. Last event of a stream.
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
        /// The error message.
        detail: String,
        /// Advice for the user.
        hint: String,
    },
}

impl Event {
    /// Progress of a stage before the rounds.
    pub fn advanced(stage: Stage, done: u64, total: u64) -> Self {
        Self::StageAdvanced { stage, round: 0, done, total, steps_per_second: None }
    }
}

/// Receives events. Implementations must not block for long.
pub trait ProgressSink {
    fn event(&mut self, event: &Event);

    /// Sends an [`Event::Warning`].
    fn warn(&mut self, code: &str, message: String) {
        self.event(&Event::Warning { code: code.to_owned(), message });
    }

    /// Sends an [`Event::Log`].
    fn log(&mut self, message: String) {
        self.event(&Event::Log { message });
    }
}

impl<F: FnMut(&Event)> ProgressSink for F {
    fn event(&mut self, event: &Event) {
        self(event);
    }
}

/// A sink that ignores everything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl ProgressSink for Silent {
    fn event(&mut self, _event: &Event) {}
}
