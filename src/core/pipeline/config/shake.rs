//! What becomes of the shake of the views, and which of them a scene is trained on.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What explains the shake that deblurring leaves in the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShakeModel {
    /// A kernel a view, found from the renders, so that the scene itself stays sharp.
    Kernel,
    /// From the second round on, and only of views whose kernel tells shake from none in the
    /// renders of the round before; all others are trained deblurred.
    Late,
    /// Nothing: the scene is as blurred as the views, as in the paper.
    Off,
}

/// Which views the scene is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrainOn {
    /// The enhanced view where a kernel explains its shake, else the deblurred one.
    Auto,
    /// The deblurred views, as in the paper.
    Deblurred,
    /// The enhanced views, shaken and noisy as they are.
    Enhanced,
}

impl ShakeModel {
    /// Whether a kernel explains the shake of a view in a round. `tells`: whether the kernel found
    /// for it in the round before told shake from none.
    pub fn explains(self, round: u32, tells: bool) -> bool {
        match self {
            Self::Kernel => true,
            Self::Late => round > 1 && tells,
            Self::Off => false,
        }
    }
}
