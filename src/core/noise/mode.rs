//! What kind of noise field a round has.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The noise field of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseMode {
    /// On a grid of 1/8 resolution, signed, zero mean.
    Grid,
    /// At every pixel, positive: the paper's.
    Paper,
    /// None.
    Off,
}

/// Side of a cell of mode `Grid`, px.
const CELL: u32 = 8;
/// Weight of the mean squared noise in mode `Grid`; the paper has none.
pub(super) const PENALTY: f64 = 0.01;

/// Side of a cell that the network is asked about, px.
pub(super) fn cell_side(mode: NoiseMode) -> u32 {
    if mode == NoiseMode::Grid { CELL } else { 1 }
}
