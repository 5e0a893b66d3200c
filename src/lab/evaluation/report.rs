//! The shape of `evaluation.json`: what sharp photographs say about a run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How one run's scene looks from where sharp photographs were taken that it did not train on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Views that trained the scene.
    pub training_views: usize,
    /// Of them those whose cameras the truth knows; they tie the two worlds together.
    pub tied_views: usize,
    /// How far the tied cameras stand from the truth's once the worlds are brought together: root
    /// mean square, share of the cameras' extent.
    pub camera_error: f64,
    /// Gaussians of the scene.
    pub gaussians: usize,
    /// Of them elongated: the longest axis over ten times the middle one, and seen longer than 5 px
    /// by the nearest training view.
    pub elongated: usize,
    /// Longest side of the pictures compared, px.
    pub size: usize,
    /// The adapter that rendered.
    pub adapter: String,
    /// SHA-256 of the LPIPS network; `None` where none was given and no view has that score.
    pub lpips_network: Option<String>,
    /// The test views, in the order of their names.
    pub views: Vec<TestView>,
    /// Mean over the test views, cameras where the truth has them.
    pub mapped: ViewScores,
    /// Mean over the test views, cameras registered on the sharp photographs.
    pub registered: ViewScores,
}

/// One sharp photograph that did not train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TestView {
    /// Its name.
    pub name: String,
    /// The training view that looks most alike.
    pub nearest: String,
    /// Share of its pixels that at least two training views see.
    pub seen: f64,
    /// How far registration moved the middle of the picture, px.
    pub moved_px: f64,
    /// With the camera where the truth has it, brought into the run's world.
    pub mapped: ViewScores,
    /// With the camera registered on the sharp photograph, the scene as it is.
    pub registered: ViewScores,
}

/// The scores of a render, over all of the picture and over what two training views see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewScores {
    /// Over every pixel.
    pub all: Scores,
    /// Over the pixels that at least two training views see; `None` where there are hardly any.
    pub seen: Option<Scores>,
}

/// A render against a sharp photograph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scores {
    /// PSNR, dB.
    pub psnr_db: f64,
    /// PSNR after an affine colour fit of each channel, dB.
    pub psnr_cc_db: f64,
    /// PSNR of what is finer than 3 px, after the same fit, dB.
    pub psnr_fine_db: f64,
    /// SSIM.
    pub ssim: f64,
    /// LPIPS (SqueezeNet), lower is better; of the whole picture only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_squeeze: Option<f64>,
}
