//! Registration of photographs that did not train.

use super::forward_model::ForwardModel;
use super::forward_model::poses::Correction;
use super::{ReconstructError, TrainingView};
use crate::camera::Camera;
use crate::cancel::CancelToken;
use crate::device::{Device, Scene};
use crate::gaussians::Gaussians;
use crate::shake::Response;

/// Number of corrections of a view that did not train.
pub const CORRECTIONS: u32 = 4;

/// A fixed scene with photographs kept out of training, whose poses would otherwise be less
/// accurate than those of training views. It only renders forward: nothing of the photographs
/// enters the scene.
pub struct Registration<'a> {
    model: ForwardModel<'a>,
    scene: Box<dyn Scene>,
    sh_degree: u32,
}

impl<'a> Registration<'a> {
    /// Registers `views` to `scene`. `shake` is the response from light to values, if the views are
    /// shaken.
    ///
    /// # Errors
    /// [`ReconstructError::Empty`] without views or Gaussians; a device error.
    pub fn new(
        device: &Device,
        views: &'a [TrainingView],
        scene: &Gaussians,
        shake: Option<&Response>,
    ) -> Result<Self, ReconstructError> {
        Ok(Self {
            model: ForwardModel::new(views, scene, shake)?,
            scene: device.scene(scene)?,
            sh_degree: scene.sh_degree,
        })
    }

    /// Returns the views' cameras, corrected by renders of the scene, which is about `depth` world
    /// units away.
    ///
    /// # Errors
    /// Cancelled, or a device error.
    pub fn cameras(
        mut self,
        depth: f64,
        cancel: &CancelToken,
    ) -> Result<Vec<Camera>, ReconstructError> {
        for left in (0..CORRECTIONS).rev() {
            let how = Correction { depth, degree: self.sh_degree, is_coarse: left > 0 };
            self.model.estimate_shake(&mut *self.scene, self.sh_degree, cancel)?;
            self.model.correct_cameras(&mut *self.scene, how, cancel)?;
        }
        Ok(self.model.cameras())
    }
}
