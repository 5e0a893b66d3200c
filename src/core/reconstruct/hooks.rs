//! Whom a round tells, and who may stop it.

use super::checkpoint::Checkpoint;
use crate::cancel::CancelToken;

/// Takes done steps, all steps and steps per second.
pub type ProgressHook<'a> = &'a mut dyn FnMut(u64, u64, f64);
/// Takes a checkpoint, at least once a minute.
pub type CheckpointHook<'a> = &'a mut dyn FnMut(&Checkpoint);

/// Whom a round tells, and who may stop it.
pub struct TrainHooks<'a> {
    /// Checked between submissions.
    pub cancel: &'a CancelToken,
    /// About four times a second.
    pub progress: ProgressHook<'a>,
    /// `None`: no checkpoints are made.
    pub checkpoint: Option<CheckpointHook<'a>>,
}
