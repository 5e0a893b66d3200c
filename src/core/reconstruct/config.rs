//! What a round is trained with.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::schedule::Schedule;
use crate::noise::NoiseMode;
use crate::shake::Response;

/// What training renders the splats before. Delivered views have a black background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// Black: what is dark in every view may turn transparent.
    Black,
    /// Another colour at every step, so that only what is opaque looks right. Differs from the
    /// paper: its views fill their frames too, and what is seen through from elsewhere is a hole.
    Random,
}

/// How Gaussians come and go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Densify {
    /// MCMC: relocation and growth up to the cap.
    Mcmc,
    /// Clone, split and prune by gradients, as first published; at most the cap.
    Classic,
}

/// What a round is trained with.
#[derive(Clone, Debug)]
pub struct TrainConfig {
    /// Optimiser steps.
    pub steps: u32,
    /// Explain the shake of the views, whose values come from light like this; `None`: they are not
    /// shaken.
    pub shake: Option<Response>,
    /// Correct the cameras by the renders. The number is about how far away the scene is, world
    /// units; `None`: they stand where the poses say.
    pub refine_poses: Option<f64>,
    /// Most Gaussians.
    pub cap: usize,
    /// Degree of the harmonics.
    pub sh_degree: u32,
    /// The noise field.
    pub noise: NoiseMode,
    /// Train at 1/4, 1/2, then full resolution.
    pub resolution_schedule: bool,
    /// Whether the round starts from a trained scene.
    pub warm: bool,
    /// What lies behind the splats.
    pub background: Background,
    /// How Gaussians come and go.
    pub densify: Densify,
    /// Seed of everything random.
    pub seed: u64,
    /// [`scene_extent`](super::scene_extent), world units.
    pub extent: f64,
}

impl TrainConfig {
    /// What changes over the round.
    pub fn schedule(&self) -> Schedule {
        Schedule {
            steps: self.steps,
            sh_degree: self.sh_degree,
            resolution: self.resolution_schedule,
            warm: self.warm,
            seed: self.seed,
        }
    }
}
