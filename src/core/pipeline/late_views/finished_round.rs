//! The inputs of the search for late views.

use crate::capture::Capture;
use crate::image::Image;
use crate::metrics::RoundMetrics;
use crate::pipeline::reconstruct::TrainedScene;
use crate::pipeline::round::Round;
use crate::pipeline::views::View;
use crate::poses::Poses;

/// A finished round and its inputs.
#[derive(Clone, Copy)]
pub struct FinishedRound<'a> {
    /// All photographs.
    pub capture: &'a Capture,
    /// Their poses.
    pub poses: &'a Poses,
    /// The round.
    pub round: &'a Round,
    /// The views with a pose, with the cameras of the round's training.
    pub views: &'a [View],
    /// R_i.
    pub renders: &'a [Image],
    /// V_i.
    pub scene: &'a TrainedScene,
    /// The round's metrics, with the fit of each view.
    pub metrics: &'a RoundMetrics,
}
