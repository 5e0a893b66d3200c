//! What late views are found by.

use crate::capture::Capture;
use crate::image::Image;
use crate::metrics::RoundMetrics;
use crate::pipeline::reconstruct::TrainedScene;
use crate::pipeline::round::Round;
use crate::pipeline::views::View;
use crate::poses::Poses;

/// A finished round, and what it was made from.
#[derive(Clone, Copy)]
pub struct FinishedRound<'a> {
    /// All photographs.
    pub capture: &'a Capture,
    /// Where they were found.
    pub poses: &'a Poses,
    /// The round.
    pub round: &'a Round,
    /// Those with a pose, where the round's training left them.
    pub views: &'a [View],
    /// R_i.
    pub renders: &'a [Image],
    /// V_i.
    pub scene: &'a TrainedScene,
    /// How each view fits its render.
    pub metrics: &'a RoundMetrics,
}
