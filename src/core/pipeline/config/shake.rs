//! What becomes of the shake of the views, and which of them a scene is trained on.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What explains the shake that deblurring leaves in the views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShakeModel {
    /// A kernel a view, found from the renders, so that the scene itself stays sharp.
    Kernel,
    /// A kernel only for views that are found shaken: from the second round on, by the renders of
    /// the round before; where most views are still, from the first.
    Late,
    /// Nothing: the scene is as blurred as the views, as in the paper.
    Off,
}

/// Which views the scene is trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrainOn {
    /// The enhanced view where a kernel explains its shake, the deblurred one where deblurring took
    /// a shake out of it, else the mean of both.
    Auto,
    /// The deblurred views, as in the paper.
    Deblurred,
    /// The enhanced views, shaken and noisy as they are.
    Enhanced,
}

impl ShakeModel {
    /// Whether a kernel explains the shake of a view. `tells`: whether what is known of it before
    /// the round tells shake from none.
    pub fn explains(self, tells: bool) -> bool {
        match self {
            Self::Kernel => true,
            Self::Late => tells,
            Self::Off => false,
        }
    }
}
