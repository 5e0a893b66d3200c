//! The forward model: renders the scene's Gaussians from the camera of each view and applies the
//! view's shake. Cameras and kernels are estimated here, from renders of the current scene.

pub(super) mod poses;
mod shakes;

use super::observed::Observed;
use super::{ReconstructError, TrainingView};
use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::shake::Response;

/// The views of a scene.
pub(super) struct ForwardModel<'a> {
    /// In the order given.
    pub(super) views: Vec<Observed<'a>>,
    /// The response from light to the views' values, if they are shaken; else `None`.
    response: Option<Response>,
}

impl<'a> ForwardModel<'a> {
    /// The views at full resolution, without shake, at the given cameras.
    ///
    /// # Errors
    /// [`ReconstructError::Empty`] without views or Gaussians.
    pub(super) fn new(
        views: &'a [TrainingView],
        scene: &Gaussians,
        response: Option<&Response>,
    ) -> Result<Self, ReconstructError> {
        if views.is_empty() || scene.is_empty() {
            return Err(ReconstructError::Empty { views: views.len(), gaussians: scene.len() });
        }
        Ok(Self { views: views.iter().map(Observed::new).collect(), response: response.cloned() })
    }

    /// Reduces the images by `divisor` and resets the kernels, which depend on the resolution.
    pub(super) fn reduce(&mut self, divisor: usize) {
        self.views.iter_mut().for_each(|view| view.reduce(divisor));
    }

    /// Standard deviation of the noise at full size, mean over the views whose noise is known;
    /// `None` without such views.
    pub(super) fn expected_noise(&self) -> Option<f64> {
        let views = self.views.iter().map(Observed::given);
        let known = views.filter_map(|view| Some(view.noise?.mean_over(&view.image)));
        let known: Vec<f64> = known.collect();
        (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
    }

    /// The views' current cameras, at the full size of their images.
    pub(super) fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(Observed::full_camera).collect()
    }
}
