//! The callbacks of a training round.

use fled_gpu::GpuError;

use super::checkpoint::Checkpoint;
use super::look::Look;
use crate::cancel::CancelToken;

/// Receives done steps, all steps and steps per second.
pub type ProgressHook<'a> = &'a mut dyn FnMut(u64, u64, f64);
/// Receives a checkpoint: about every 30 seconds, and when the round is cancelled.
pub type CheckpointHook<'a> = &'a mut dyn FnMut(&Checkpoint);
/// Receives the state of training every 25 steps.
pub type SeenHook<'a> = &'a mut dyn FnMut(Seen);
/// May render the current scene: about every 25 steps, and after the last.
pub type LookHook<'a> = &'a mut dyn FnMut(&mut Look<'_>) -> Result<(), GpuError>;

/// The state of training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Steps done.
    pub step: u32,
    /// Loss of the last step's view; it scatters, because views differ.
    pub loss: f64,
    /// Gaussians of the scene.
    pub gaussians: usize,
}

/// The callbacks of a training round.
pub struct TrainHooks<'a> {
    /// Checked between submissions. The running step is finished, and the checkpoint hook, if any,
    /// receives the state after it.
    pub cancel: &'a CancelToken,
    /// Called about four times a second.
    pub progress: ProgressHook<'a>,
    /// `None` makes no checkpoints.
    pub checkpoint: Option<CheckpointHook<'a>>,
    pub seen: Option<SeenHook<'a>>,
    /// `None` renders nothing. Training is the same either way.
    pub look: Option<LookHook<'a>>,
}
