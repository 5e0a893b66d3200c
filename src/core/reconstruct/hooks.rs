//! Whom a round tells, and who may stop it.

use fled_gpu::GpuError;

use super::checkpoint::Checkpoint;
use super::look::Look;
use crate::cancel::CancelToken;

/// Takes done steps, all steps and steps per second.
pub type ProgressHook<'a> = &'a mut dyn FnMut(u64, u64, f64);
/// Takes a checkpoint: at least once a minute, and when the round is asked to stop.
pub type CheckpointHook<'a> = &'a mut dyn FnMut(&Checkpoint);
/// Takes how training goes, every 25 steps.
pub type SeenHook<'a> = &'a mut dyn FnMut(Seen);
/// May look at the scene as it stands: every 25 steps or so, and after the last.
pub type LookHook<'a> = &'a mut dyn FnMut(&mut Look<'_>) -> Result<(), GpuError>;

/// How training goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Steps done.
    pub step: u32,
    /// The loss of the last step's view: views differ, so it scatters about its course.
    pub loss: f64,
    /// Gaussians of the scene.
    pub gaussians: usize,
}

/// Whom a round tells, and who may stop it.
pub struct TrainHooks<'a> {
    /// Checked between submissions. The step that runs is finished, and where somebody takes
    /// checkpoints they get one of it.
    pub cancel: &'a CancelToken,
    /// About four times a second.
    pub progress: ProgressHook<'a>,
    /// `None`: no checkpoints are made.
    pub checkpoint: Option<CheckpointHook<'a>>,
    /// `None`: nobody is told.
    pub seen: Option<SeenHook<'a>>,
    /// `None`: nobody looks at the scene. What trains is the same either way.
    pub look: Option<LookHook<'a>>,
}
