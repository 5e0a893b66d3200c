//! What becomes of the shake of the views, and which of them a scene is trained on.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What explains the shake that deblurring leaves in the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShakeModel {
    /// A kernel a view, found from the renders, so that the scene itself stays sharp.
    Kernel,
    /// The same, but where there are several rounds the first is trained on the deblurred views:
    /// kernels are then found from renders that are right already.
    Late,
    /// Nothing: the scene is as blurred as the views, as in the paper.
    Off,
}

/// Which views the scene is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrainOn {
    /// The enhanced views when `shake` explains them, else the deblurred ones.
    Auto,
    /// The deblurred views, as in the paper.
    Deblurred,
    /// The enhanced views, shaken and noisy as they are.
    Enhanced,
}

impl ShakeModel {
    /// Whether kernels explain the shake in one of so many rounds.
    pub fn explains(self, round: u32, rounds: u32) -> bool {
        match self {
            Self::Kernel => true,
            Self::Late => round > 1 || rounds == 1,
            Self::Off => false,
        }
    }
}
