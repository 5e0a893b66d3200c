//! The start of a round.

use super::checkpoint::Checkpoint;
use crate::gaussians::Gaussians;

/// The start of a round.
#[derive(Clone, Debug)]
pub enum TrainStart {
    /// From these Gaussians: [`initialise`](super::initialise())d, or those of the previous round.
    Fresh(Gaussians),
    /// From a checkpoint of the same round.
    Resume(Checkpoint),
}
