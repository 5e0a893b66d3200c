//! The training interface of a device.

mod flight;
mod gpu;
mod processor;
mod state;

use fled_gpu::GpuError;

use super::densify::Plan;
use super::observed::Target;
use super::optimizer::StepUniform;
use crate::camera::Camera;
use crate::device::{Device, Scene};
use crate::gaussians::Gaussians;
use crate::image::Image;
use crate::noise::{Inspection, StateError};
use crate::shake::{Response, ShakeKernel};
use crate::splat::rows::GeometryRow;
pub use state::TrainingState;

/// The start of training on a device.
#[derive(Clone, Copy)]
pub(super) struct Setup<'a> {
    pub(super) gaussians: &'a Gaussians,
    /// Number of Gaussians to expect.
    pub(super) capacity: usize,
    /// Largest width and height of a view, px.
    pub(super) size: [usize; 2],
    pub(super) views: usize,
    /// The response from light to the views' values, if they are shaken.
    pub(super) shake: Option<&'a Response>,
    /// The seed of the noise field, if there is one.
    pub(super) noise: Option<u64>,
    /// Whether the gradients by position are summed up, for classic densification.
    pub(super) accumulates: bool,
}

/// One step of training.
#[derive(Clone, Copy)]
pub(super) struct Step<'a> {
    /// Index of the view.
    pub(super) view: usize,
    /// Its camera, at the size in training.
    pub(super) camera: &'a Camera,
    /// Active degree of the harmonics.
    pub(super) degree: u32,
    /// Colour behind the scene.
    pub(super) background: [f32; 3],
    /// The kernel of the view; `None` without shake.
    pub(super) kernel: Option<&'a ShakeKernel>,
    pub(super) update: StepUniform,
}

/// A scene in training, with its optimiser and the photographs on which it trains.
pub(super) trait Training: Scene {
    /// Number of Gaussians.
    fn count(&self) -> usize;

    /// Renders the scene in training; unlike [`Scene::render`], never with an influence on it.
    ///
    /// # Errors
    /// A device error, like all below.
    fn look(&mut self, camera: &Camera, degree: u32) -> Result<Image, GpuError>;

    /// Changes the sizes of the views in px, and discards their targets.
    fn set_sizes(&mut self, sizes: &[[usize; 2]]) -> Result<(), GpuError>;

    /// Whether a view has a target.
    fn has_target(&self, view: usize) -> bool;

    /// Sets the target of a view, at its size.
    fn set_target(&mut self, view: usize, target: &Target) -> Result<(), GpuError>;

    /// Starts a step.
    fn submit(&mut self, step: &Step<'_>) -> Result<(), GpuError>;

    /// Waits until at most `left` steps are in flight. Returns the numbers of those that changed
    /// nothing, because their intersections did not fit, and must be repeated.
    fn settle(&mut self, left: usize) -> Result<Vec<u32>, GpuError>;

    /// Waits for all steps and returns whether none of them must be repeated. Keeps them in flight:
    /// the step after one that must be repeated precedes its repetition, so an earlier repetition
    /// would train another scene.
    fn is_done(&mut self) -> Result<bool, GpuError>;

    /// The loss of the last step.
    fn loss(&self) -> Result<f64, GpuError>;

    /// Number of updates dropped so far because a gradient was not finite.
    fn non_finite(&self) -> Result<u32, GpuError>;

    /// The geometry of all Gaussians.
    fn geometry(&self) -> Result<Vec<GeometryRow>, GpuError>;

    /// Runs a densification: copies, shapes, cleared moments.
    fn relocate(&mut self, plan: &Plan) -> Result<(), GpuError>;

    /// Compares the noise map of the last step with its render; `None` without a noise field.
    fn inspect_noise(&self) -> Result<Option<Inspection>, GpuError>;

    /// The state, with nothing in flight.
    fn save(&self) -> Result<TrainingState, GpuError>;

    /// Restores a state with harmonics of the same degree.
    ///
    /// # Errors
    /// [`StateError`] for another noise field's state; a device error.
    fn restore(&mut self, state: &TrainingState) -> Result<(), StateError>;

    /// Number of steps in flight.
    #[cfg(test)]
    fn in_flight(&self) -> usize;
}

/// Prepares training on a device.
///
/// # Errors
/// A device error, typically out of memory.
pub(super) fn begin(device: &Device, setup: &Setup<'_>) -> Result<Box<dyn Training>, GpuError> {
    Ok(match device {
        Device::Gpu(gpu) => Box::new(gpu::GpuTraining::new(gpu, setup)?),
        Device::Processor => Box::new(processor::ProcessorTraining::new(setup)),
    })
}
