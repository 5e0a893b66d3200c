//! Where a round begins.

use super::checkpoint::Checkpoint;
use crate::gaussians::Gaussians;

/// Where a round begins.
#[derive(Clone, Debug)]
pub enum TrainStart {
    /// From these Gaussians: [`initialise`](super::initialise())d, or those of the round before.
    Fresh(Gaussians),
    /// From the middle of the same round.
    Resume(Checkpoint),
}
