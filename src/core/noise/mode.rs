//! Whether a round has a noise field.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The noise field of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseMode {
    /// At every pixel, positive: the paper's.
    Paper,
    /// None.
    Off,
}
