//! The schema of `evaluation.json`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The quality of a run's scene at the cameras of sharp photographs that it was not trained on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Number of training views.
    pub training_views: usize,
    /// Training views with a camera in the truth; they connect the two worlds.
    pub tied_views: usize,
    /// Distance of these cameras from the truth's after the alignment: root mean square, as a share
    /// of the cameras' extent.
    pub camera_error: f64,
    /// Number of Gaussians in the scene.
    pub gaussians: usize,
    /// Number of elongated Gaussians: longest axis over ten times the middle one, and longer than 5
    /// px in the nearest training view.
    pub elongated: usize,
    /// Longest side of the pictures compared, px.
    pub size: usize,
    /// The adapter that rendered.
    pub adapter: String,
    /// SHA-256 of the LPIPS network; `None` without one, and no view has that score.
    pub lpips_network: Option<String>,
    /// The test views, in the order of their names.
    pub views: Vec<TestView>,
    /// Mean over the test views with the cameras of the truth.
    pub mapped: ViewScores,
    /// Mean over the test views with cameras registered to the sharp photographs.
    pub registered: ViewScores,
}

/// One sharp photograph that was not used in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TestView {
    pub name: String,
    /// The most similar training view.
    pub nearest: String,
    /// Share of its pixels that at least two training views see.
    pub seen: f64,
    /// Distance by which registration moved the middle of the picture, px.
    pub moved_px: f64,
    /// Scores with the camera of the truth, mapped into the run's world.
    pub mapped: ViewScores,
    /// Scores with the camera registered to the sharp photograph; the scene is fixed.
    pub registered: ViewScores,
}

/// The scores of a render, over the whole picture and over the pixels that two training views see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewScores {
    /// Over every pixel.
    pub all: Scores,
    /// Over the pixels that at least two training views see; `None` if there are hardly any.
    pub seen: Option<Scores>,
}

/// Scores of a render against a sharp photograph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scores {
    /// PSNR, dB.
    pub psnr_db: f64,
    /// PSNR after an affine colour fit of each channel, dB.
    pub psnr_cc_db: f64,
    /// PSNR of detail finer than 3 px, after the same fit, dB.
    pub psnr_fine_db: f64,
    /// SSIM.
    pub ssim: f64,
    /// LPIPS (SqueezeNet), lower is better; only of the whole picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_squeeze: Option<f64>,
}
