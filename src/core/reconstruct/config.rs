//! What a round is trained with.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::schedule::Schedule;
use crate::noise::NoiseMode;
use crate::shake::Response;
use crate::stereo::Stereo;

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
    /// No change of the number of Gaussians.
    Off,
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
    /// Share of the Gaussians that a step at the end of the round goes without; it grows from
    /// nothing. Against floaters that only few views see.
    pub dropout: f64,
    /// How Gaussians come and go.
    pub densify: Densify,
    /// What the views agree on about depth: MCMC moves Gaussians away from where nothing can be.
    pub stereo: Option<Arc<Stereo>>,
    /// Take differences of exposure and cast between the views out of their images.
    pub view_colour: bool,
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
