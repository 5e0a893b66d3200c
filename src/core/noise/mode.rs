//! The noise field option of a round.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The noise field of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseMode {
    /// Positive noise at every pixel, as in the paper.
    Paper,
    /// No noise field.
    Off,
}
