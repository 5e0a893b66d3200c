//! What `auto` stands for in numbers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How much detail a run trains where `steps`, `size` and `cap` are `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Detail {
    /// `high` on a GPU with at least 6 GB of memory of its own, else `standard`; the machine that
    /// trains decides.
    Auto,
    /// For a processor, which trains it in minutes: 560 px, 30,000 Gaussians, 1,000 steps a round.
    Standard,
    /// For a GPU: 1,600 px, 1,000,000 Gaussians, 3,500 steps a round. Without a GPU it is
    /// refused unless `adapter` names the device.
    High,
}

impl Detail {
    /// Optimiser steps of a round.
    pub(super) fn steps(self) -> u32 {
        if self == Self::High { 3_500 } else { 1_000 }
    }

    /// Longest side of the working images, px.
    pub(super) fn side(self) -> u32 {
        if self == Self::High { 1_600 } else { 560 }
    }

    /// Largest number of Gaussians.
    pub(super) fn cap(self) -> u32 {
        if self == Self::High { 1_000_000 } else { 30_000 }
    }
}
