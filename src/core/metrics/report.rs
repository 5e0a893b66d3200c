//! The shape of `metrics.json` and of the service's `/rounds`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Split;
use crate::enhance::Anchor;

/// Which image was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageKind {
    /// A render of the scene: our result.
    Render,
    /// The deblurred view.
    Deblurred,
    /// The brightened view: what a user has without fled.
    Enhanced,
}

/// Against what it was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// Sharp, bright ground truth.
    Gt,
    /// The deblurred view: self-consistency, not quality.
    Deblurred,
    /// The brightened view: self-consistency, not quality.
    Enhanced,
}

/// At which brightness both were compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Brightness {
    /// The round's own.
    Native,
    /// The target's.
    Final,
}

/// Mean scores of one set of views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Record {
    /// Train or held-out.
    pub split: Split,
    /// Which image.
    pub image: ImageKind,
    /// Against what.
    pub reference: Reference,
    /// At which brightness.
    pub brightness: Brightness,
    /// Number of views in the mean.
    pub views: u32,
    /// Mean PSNR, dB.
    pub psnr_db: f64,
    /// Mean PSNR after a per-channel affine colour fit, dB.
    pub psnr_cc_db: f64,
    /// Mean SSIM of the valid region.
    pub ssim: f64,
    /// LPIPS (SqueezeNet) where the user supplies the network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_squeeze: Option<f64>,
}

/// How one photograph came out: a mean hides a view that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewScore {
    /// The view.
    pub name: String,
    /// Whether it has a pose. One without is left out: it has no split and no scores.
    pub registered: bool,
    /// Train or held-out.
    pub split: Option<Split>,
    /// What its render at the target brightness was compared with: ground truth where the capture
    /// brings it, else the brightened view, which is self-consistency and not quality.
    pub reference: Option<Reference>,
    /// PSNR, dB.
    pub psnr_db: Option<f64>,
    /// PSNR after a per-channel affine colour fit, dB.
    pub psnr_cc_db: Option<f64>,
    /// SSIM of the valid region.
    pub ssim: Option<f64>,
    /// Root mean square distance that the shake between render and brightened view moves its light,
    /// px of the working size.
    pub shake_px: Option<f64>,
    /// Whether that shake is told from none: then a kernel may explain it in the next round.
    #[serde(default)]
    pub is_shaken: Option<bool>,
    /// Correlation of its structures with those of its render, shaken as it is: near 1 where the
    /// view stands where its pose says, near 0 where it does not.
    #[serde(default)]
    pub fit: Option<f64>,
}

/// One round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RoundMetrics {
    /// 1-based.
    pub round: u32,
    /// Wall seconds of the whole round.
    pub seconds: f64,
    /// Gaussians in the round's scene.
    pub gaussians: u64,
    /// Optimiser steps made.
    pub steps: u64,
    /// Training steps per second.
    pub steps_per_second: f64,
    /// Scores, means over the views of a split.
    pub records: Vec<Record>,
    /// Scores of every photograph of the capture; none in reports of earlier versions.
    #[serde(default)]
    pub views: Vec<ViewScore>,
    /// Mean noise sigma of the enhanced and the deblurred views and of the renders (Immerkaer,
    /// luma, 0..=1).
    pub noise_sigma: BTreeMap<String, f64>,
    /// Mean noise-corrected sharpness of the same images.
    pub sharpness: BTreeMap<String, f64>,
    /// Mean of V of the enhanced views.
    pub mean_brightness: f64,
    /// Share of clipped pixels of the enhanced views.
    pub clipped: f64,
    /// Noise ceiling of self-consistency against the enhanced views: -20 log10(sigma), dB.
    pub noise_ceiling_db: f64,
    /// Mean over the views of the noise map's mean and of its spread; absent when the noise field
    /// was off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_map: Option<NoiseMapStatistics>,
    /// Training views whose shake a kernel explained; the others were trained on deblurred.
    #[serde(default)]
    pub kernels: u32,
    /// Root mean square distance that the shake found in those views moves their light, mean over
    /// the views, px of the working size; `None` where no kernel was looked for.
    pub shake_px: Option<f64>,
    /// Mean way that the correction of the cameras moved the middle of the images in this round,
    /// px; `null` when they stand where the poses say.
    pub pose_correction_px: Option<f64>,
    /// Gradients that were not finite and were dropped.
    pub non_finite_gradients: u64,
    /// The round's brightness.
    pub anchor: Anchor,
    /// What was fitted to map this round's renders to the next brightness, one a view or one in
    /// all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub matched: Vec<Anchor>,
    /// What rounds are compared by: PSNR (dB) of the renders at the target brightness, each first
    /// shaken as its view is, against the views at that brightness; of held-out views where there
    /// are any. SSIM, below 1, in reports of earlier versions, or `None`.
    #[serde(default)]
    pub score: Option<f64>,
    /// Whether the round was judged worse than the one before it.
    pub worse_than_previous: bool,
}

/// What the noise field learnt.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseMapStatistics {
    /// Mean value.
    pub mean: f64,
    /// Standard deviation over pixels.
    pub spread: f64,
    /// Largest |correlation| with the render over the round's checks.
    pub correlation: f64,
}

/// The shake of a capture as a whole, found before anything is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptureShake {
    /// The run is plain splatting: one round with the steps of all, cameras as found, and a kernel
    /// for the few shaken views. Another round follows only where late views change the poses.
    Still,
    /// The views are a little softer than the scene: it is trained as the network deblurs them,
    /// without kernels.
    Soft,
    /// A kernel explains the shake of every view that has one, from the second round on.
    Shaken,
}

/// The whole of `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Report {
    /// Every round, in order.
    pub rounds: Vec<RoundMetrics>,
    /// The delivered round, 1-based.
    pub best_round: u32,
    /// Views with a pose.
    pub registered: u32,
    /// Views in the capture.
    pub views: u32,
    /// Views found shaken before the rounds: deblurring took a shake out of them. Absent: the
    /// options left nothing to decide.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaken_views: Option<u32>,
    /// The verdict on the capture as a whole, which decides how the rounds are made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capture_shake: Option<CaptureShake>,
    /// Wall seconds by stage.
    pub stages: BTreeMap<String, f64>,
    /// The GPU adapter and its driver.
    pub adapter: String,
    /// Networks used: role to `id sha256 provider`.
    pub models: BTreeMap<String, String>,
    /// What was used in place of what was asked for, and why.
    pub fallbacks: Vec<String>,
    /// Facts of the poses: source, rung, points, reprojection error, mean track, and the verdict on
    /// every photograph's place.
    pub poses: BTreeMap<String, serde_json::Value>,
    /// Seed of the run.
    pub seed: u64,
    /// Options as run.
    pub config: serde_json::Value,
}
