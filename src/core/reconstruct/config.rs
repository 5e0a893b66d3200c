//! The configuration of a round's training.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::schedule::Schedule;
use crate::noise::NoiseMode;
use crate::shake::Response;

/// Background of the renders in training. Delivered views have a black background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// Black: parts that are dark in every view may become transparent.
    Black,
    /// A random colour at every step, so that only opaque Gaussians look right. Differs from the
    /// paper: its views fill their frames too, but a surface that they see through is a hole from
    /// elsewhere.
    Random,
}

/// How Gaussians are added and removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Densify {
    /// MCMC: relocation and growth up to the cap.
    Mcmc,
    /// Clone, split and prune by gradients, as first published, up to the cap.
    Classic,
}

/// Rates, resolution and densification of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// Adapted to short rounds: larger rates, and reduced images at first.
    Adapted,
    /// As 3D Gaussian splatting was first published: its rates, start and extent, at full
    /// resolution, with densification from step 500 until half of the round.
    Published,
}

/// The configuration of a round's training.
#[derive(Clone, Debug)]
pub struct TrainConfig {
    /// Optimiser steps.
    pub steps: u32,
    /// Estimates the shake of the views with this response from light to values; `None` leaves them
    /// without kernels.
    pub shake: Option<Response>,
    /// Corrects the cameras by the renders, given the approximate distance of the scene, world
    /// units; `None` leaves them at their poses.
    pub refine_poses: Option<f64>,
    /// Maximum number of Gaussians.
    pub cap: usize,
    /// Degree of the harmonics.
    pub sh_degree: u32,
    /// The noise field.
    pub noise: NoiseMode,
    /// Train at 1/4, 1/2, then full resolution.
    pub resolution_schedule: bool,
    /// Rates, first opacities and scales, and when densification runs.
    pub pace: Pace,
    /// Whether the round starts from a trained scene.
    pub warm: bool,
    /// Background of the splats.
    pub background: Background,
    /// How Gaussians are added and removed.
    pub densify: Densify,
    /// Random seed.
    pub seed: u64,
    /// [`scene_extent`](super::scene_extent) or, at the published pace,
    /// [`camera_extent`](super::camera_extent), world units.
    pub extent: f64,
}

impl TrainConfig {
    /// The schedule of the round.
    pub fn schedule(&self) -> Schedule {
        Schedule {
            steps: self.steps,
            sh_degree: self.sh_degree,
            resolution: self.resolution_schedule,
            pace: self.pace,
            warm: self.warm,
            seed: self.seed,
        }
    }
}
