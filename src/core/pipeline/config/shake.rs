//! Options for the shake of views, and for what a scene is trained on and by which loss.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The model of the shake that deblurring leaves in the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShakeModel {
    /// A kernel per view, estimated from the renders, so that the scene itself stays sharp.
    Kernel,
    /// A kernel only for shaken views: from the second round on, judged by the renders of the
    /// previous round; from the first round on if most views are still.
    Late,
    /// Nothing: the scene is as blurred as the views, as in the paper.
    Off,
}

/// Which views the scene is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrainOn {
    /// The enhanced view where a kernel explains its shake, the deblurred one where deblurring
    /// removed a shake, else the mean of both.
    Auto,
    /// The deblurred views, as in the paper.
    Deblurred,
    /// The enhanced views, shaken and noisy as they are.
    Enhanced,
}

/// How training compares a render with a photograph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LossModel {
    /// L1 and an SSIM that expects the noise of each training image, measured against the deblurred
    /// view; images that are deblurred have none.
    NoiseAware,
    /// L1 and SSIM, as in the paper.
    Plain,
}

impl ShakeModel {
    /// Whether a view has a kernel, by whether it was found shaken before the round.
    pub fn has_kernel(self, is_shaken: bool) -> bool {
        match self {
            Self::Kernel => true,
            Self::Late => is_shaken,
            Self::Off => false,
        }
    }
}
