//! The schema of `metrics.json` and of the service's `/rounds`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Split;
use crate::enhance::Anchor;

/// The image that was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ImageKind {
    /// A render of the scene: fled's result.
    Render,
    /// The deblurred view.
    Deblurred,
    /// The brightened view: the alternative without fled.
    Enhanced,
}

/// The reference of a comparison.
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

/// The brightness of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Brightness {
    /// The round's brightness.
    Native,
    /// The target's brightness.
    Final,
}

/// Mean scores of one set of views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Record {
    /// Train or held-out.
    pub split: Split,
    pub image: ImageKind,
    pub reference: Reference,
    pub brightness: Brightness,
    /// Number of views in the mean.
    pub views: u32,
    /// Mean PSNR, dB.
    pub psnr_db: f64,
    /// Mean PSNR after a per-channel affine colour fit, dB.
    pub psnr_cc_db: f64,
    /// Mean SSIM of the valid region.
    pub ssim: f64,
    /// LPIPS (SqueezeNet), if the user supplies the network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_squeeze: Option<f64>,
}

/// The quality of one photograph; a mean would hide a view that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewScore {
    /// Name of the view.
    pub name: String,
    /// Whether it has a pose; a view without one has no split and no scores.
    pub registered: bool,
    /// Train or held-out.
    pub split: Option<Split>,
    /// Reference of its render at the target brightness: ground truth if the capture has it, else
    /// the brightened view, which measures self-consistency and not quality.
    pub reference: Option<Reference>,
    /// PSNR, dB.
    pub psnr_db: Option<f64>,
    /// PSNR after a per-channel affine colour fit, dB.
    pub psnr_cc_db: Option<f64>,
    /// SSIM of the valid region.
    pub ssim: Option<f64>,
    /// The same colour-fitted PSNR of the brightened photograph, dB: what the view would score
    /// without fled. Absent without ground truth and in reports of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub photograph_psnr_cc_db: Option<f64>,
    /// Root mean square distance by which the shake between render and brightened view moves light,
    /// px of the working size.
    pub shake_px: Option<f64>,
    /// Whether that shake is significant; a kernel may then explain it in the next round.
    #[serde(default)]
    pub is_shaken: Option<bool>,
    /// Correlation of its structures with those of its shaken render: near 1 if its pose is right,
    /// near 0 if not.
    #[serde(default)]
    pub fit: Option<f64>,
}

/// The metrics of one round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RoundMetrics {
    /// 1-based.
    pub round: u32,
    /// Wall seconds of the whole round.
    pub seconds: f64,
    /// Number of Gaussians in the round's scene.
    pub gaussians: u64,
    /// Most Gaussians, if that is fewer than the options say because the device ran out of memory.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lowered_cap: Option<u64>,
    /// Number of optimiser steps.
    pub steps: u64,
    /// Training steps per second.
    pub steps_per_second: f64,
    /// Seconds of training between the steps, in the process that ended it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub between: Option<BetweenSteps>,
    /// Mean scores over the views of a split.
    pub records: Vec<Record>,
    /// Scores of every photograph of the capture; empty in reports of earlier versions.
    #[serde(default)]
    pub views: Vec<ViewScore>,
    /// Mean noise sigma of the enhanced and the deblurred views and of the renders (Immerkaer,
    /// luma, 0..=1).
    pub noise_sigma: BTreeMap<String, f64>,
    /// Mean noise-corrected sharpness of the same images.
    pub sharpness: BTreeMap<String, f64>,
    /// Mean of V over the enhanced views.
    pub mean_brightness: f64,
    /// Share of clipped pixels of the enhanced views.
    pub clipped: f64,
    /// Noise ceiling of self-consistency against the enhanced views: -20 log10(sigma), dB.
    pub noise_ceiling_db: f64,
    /// Mean over the views of the noise map's mean and of its spread; absent without a noise field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_map: Option<NoiseMapStatistics>,
    /// Standard deviation of the noise that the loss expected, 0..=1, mean over the training views
    /// whose noise is known; views that train deblurred have none. Absent if it expected none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_noise: Option<f64>,
    /// Number of training views with a kernel; the others trained without one.
    #[serde(default)]
    pub kernels: u32,
    /// Root mean square distance by which the shake of those views moves light, mean over the
    /// views, px of the working size; `None` without kernels.
    pub shake_px: Option<f64>,
    /// Mean distance by which the correction of the cameras moved the middle of the images in this
    /// round, px; `null` without a correction.
    pub pose_correction_px: Option<f64>,
    /// Gradients dropped because they were not finite.
    pub non_finite_gradients: u64,
    /// The round's brightness.
    pub anchor: Anchor,
    /// Fitted anchors that map this round's renders to the next brightness, one per view or one for
    /// all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub matched: Vec<Anchor>,
    /// Score that compares rounds: colour-fitted PSNR (dB) of the renders at the target brightness,
    /// each shaken as its view is, against the views at that brightness; over held-out views if
    /// there are any. SSIM, below 1, in reports of earlier versions, or `None`.
    #[serde(default)]
    pub score: Option<f64>,
    /// Whether the round was judged worse than the previous one.
    pub worse_than_previous: bool,
}

/// Wall seconds that training spends between its steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BetweenSteps {
    /// Solving for the kernels of the shake.
    pub kernels: f64,
    /// Correcting the cameras.
    pub cameras: f64,
    /// Moving and adding Gaussians.
    pub growth: f64,
    /// Showing the scene in training and scoring held-out views.
    pub pictures: f64,
    /// Saving checkpoints.
    pub checkpoints: f64,
}

impl BetweenSteps {
    /// Every part with its name.
    pub fn parts(&self) -> [(&'static str, f64); 5] {
        [
            ("kernels", self.kernels),
            ("cameras", self.cameras),
            ("growth", self.growth),
            ("pictures", self.pictures),
            ("checkpoints", self.checkpoints),
        ]
    }
}

/// Statistics of the learnt noise field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct NoiseMapStatistics {
    /// Mean value.
    pub mean: f64,
    /// Standard deviation over pixels.
    pub spread: f64,
    /// Largest |correlation| with the render over the round's checks.
    pub correlation: f64,
}

/// The shake of a capture as a whole, found before training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CaptureShake {
    /// Still: the run is plain splatting with one round of all steps, uncorrected cameras, and a
    /// kernel for the few shaken views. Another round follows only if late views change the poses.
    Still,
    /// Shaken, at least in part: from the second round on, a kernel explains the shake of each view
    /// with a significant one. Earlier versions had a third verdict, `soft`.
    #[serde(alias = "soft")]
    Shaken,
}

/// How much detail a run trains where its options leave that to the device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ChosenDetail {
    /// The chosen level.
    pub level: DetailLevel,
    /// The fact about the device that decided it.
    pub because: String,
}

/// A level of detail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DetailLevel {
    /// For processors, which train it in minutes.
    Standard,
    /// For GPUs.
    High,
}

impl DetailLevel {
    /// The name used in JSON, logs and SQL.
    pub fn name(self) -> &'static str {
        match self {
            Self::Standard => "standard",
            Self::High => "high",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Standard, Self::High].into_iter().find(|level| level.name() == name)
    }
}

/// The exposures of a capture's photographs, found before the rounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CaptureExposure {
    /// The share of the solved exposures by which the photographs were evened; 0 leaves them as
    /// taken.
    pub share: f64,
    /// What was done, and why.
    pub verdict: String,
    /// Least and largest exposure of a training view, stops relative to their mean.
    pub spread_stops: [f64; 2],
    /// Median deviation of the pairs' measured light ratios from those of the solved exposures,
    /// stops. Near 0 where one exposure for each view explains them; `None` without pairs.
    pub residual_stops: Option<f64>,
    /// Ordered pairs of views that show enough common surface.
    pub pairs: u32,
    /// Solved stops for each stop that EXIF records; absent where the two have too little to do
    /// with each other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exif_slope: Option<f64>,
    /// Root mean square error of coarse scenes on pixels that were left out, 0..=1: of the
    /// photographs as taken, and evened. Absent where the second was not tried.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out_error: Option<[f64; 2]>,
    /// The solved exposure of each view, by name.
    pub views: BTreeMap<String, ViewExposure>,
}

impl CaptureExposure {
    /// One sentence, with figures.
    pub fn in_words(&self) -> String {
        let Self { verdict, pairs, .. } = self;
        let [least, most] = self.spread_stops;
        let share = match self.share {
            share if share > 0.0 && share < 1.0 => format!(" by {:.0} %", 100.0 * share),
            _ => String::new(),
        };
        let residual = match self.residual_stops {
            Some(residual) => format!(", {pairs} pairs agree to {residual:.2} stops"),
            None => String::new(),
        };
        format!("{least:+.2} to {most:+.2} stops{residual}; {verdict}{share}")
    }
}

/// The exposure of one photograph.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViewExposure {
    /// Light relative to the mean of the training views, stops.
    pub stops: f64,
    /// Light of red and of blue relative to green, stops, relative to the mean likewise.
    pub tint: [f64; 2],
    /// Exposure time that EXIF records, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Sensitivity that EXIF records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<f64>,
    /// Aperture that EXIF records.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_number: Option<f64>,
}

/// The content of `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Report {
    /// Every round, in order.
    pub rounds: Vec<RoundMetrics>,
    /// The delivered round, 1-based.
    pub best_round: u32,
    /// Number of views with a pose.
    pub registered: u32,
    /// Number of views in the capture.
    pub views: u32,
    /// Number of views found shaken before the rounds, from which deblurring removed a shake.
    /// Absent if the options leave nothing to decide.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shaken_views: Option<u32>,
    /// The verdict on the capture as a whole, which determines the rounds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capture_shake: Option<CaptureShake>,
    /// The exposures of the photographs. Absent where the options leave them as taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<CaptureExposure>,
    /// The detail that the device decided. Absent if the options name it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub detail: Option<ChosenDetail>,
    /// Seconds that the run was expected to take in all, before its rounds began. Absent without a
    /// limit of minutes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_seconds: Option<f64>,
    /// The options that the device, the limit of minutes or the verdict on shake changed, with
    /// their values in effect.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub in_effect: BTreeMap<String, serde_json::Value>,
    /// Wall seconds by stage.
    pub stages: BTreeMap<String, f64>,
    /// The GPU with its driver, or the processor.
    pub adapter: String,
    /// Networks in use: role to `id sha256 provider`.
    pub models: BTreeMap<String, String>,
    /// Substitutes for requested tools, and the reasons.
    pub fallbacks: Vec<String>,
    /// Facts of the poses: source, strategy, points, reprojection error, mean track, and
    /// the verdict on the pose of every photograph.
    pub poses: BTreeMap<String, serde_json::Value>,
    /// Added to x, y and z of the PLY files it gives positions in the world of the poses; too large
    /// for `f32`. Absent where it is zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_offset: Option<[f64; 3]>,
    pub seed: u64,
    /// Options of the run.
    pub config: serde_json::Value,
}
