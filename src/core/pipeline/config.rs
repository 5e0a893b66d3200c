//! The options of a run: flat keys, the same in `--set`, in a job's JSON and in `config.json`.

mod detail;
mod setting;
mod shake;

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::deblur::NetworkChoice;
pub use crate::noise::NoiseMode;
use crate::reading::read;
pub use crate::reconstruct::{Background, Densify, Pace};
pub use detail::Detail;
pub use setting::Setting;
pub use shake::{LossModel, ShakeModel, TrainOn};

/// Configuration of a run. Defaults are those of the `standard` preset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// How much detail is trained where `steps`, `size` and `cap` are `auto`.
    pub detail: Detail,
    /// Minutes that the run may take once its photographs are read; `auto` sets no limit. Where
    /// `size`, `cap` and `steps` are `auto`, they are as large as this machine can manage in that
    /// time, whatever `detail` says.
    #[schemars(schema_with = "setting::schema::<1, 1_440>")]
    pub minutes: Setting,
    /// Number of rounds, each of which brightens, deblurs and reconstructs. `auto` is 2, or 1 for a
    /// still capture.
    #[schemars(schema_with = "setting::schema::<1, 8>")]
    pub rounds: Setting,
    /// Optimiser steps per round. `auto` is 1,000 (3,500 with `detail=high`), or twice as many for
    /// a still capture if `rounds` is `auto`, too.
    #[schemars(schema_with = "setting::schema::<1, 200_000>")]
    pub steps: Setting,
    /// Longest side of the working images, px; never above the original. `auto` is 560 (1,600 with
    /// `detail=high`), but at most 820 if the capture is found shaken and 420 if strongly.
    #[schemars(schema_with = "setting::schema::<64, 4096>")]
    pub size: Setting,
    /// Target brightness: `auto`, stops such as `+3.5EV`, or one of the paper's curves:
    /// `auto-paper`, `alpha,gamma` or the name of a LuSh scene.
    pub target: String,
    /// Whether photographs of different exposure and white balance are evened.
    pub exposure: Exposure,
    /// One tone table for the scene or one per view.
    pub lut_scope: LutScope,
    /// Deblurring network: `default`, `small-u2w16`, `identity`, the name of an ONNX file in the
    /// folder of networks, or, on the command line only, a path to one.
    #[schemars(with = "String")]
    pub deblur: NetworkChoice,
    /// How views are brightened: `curve`, step by step, or, as a baseline, a network of 3 channels,
    /// chosen as in `deblur`. The network processes each dark photograph once, and its brightness
    /// serves every round.
    #[schemars(with = "String")]
    pub enhance: NetworkChoice,
    /// Guide of the deblurring from the second round on.
    pub guide: Guide,
    /// The noise field.
    pub noise: NoiseMode,
    /// Which views train with a kernel for the shake that deblurring leaves.
    pub shake: ShakeModel,
    /// Which views the scene is trained on.
    pub train_on: TrainOn,
    /// How training compares renders with photographs.
    pub loss: LossModel,
    /// Whether the renders correct the cameras, including those of held-out views, which are not
    /// trained on.
    pub refine_poses: bool,
    /// Whether a round's scene places photographs that have no pose, and drops views that fit it
    /// far worse than the others; both take effect in the next round.
    pub late_views: bool,
    /// How rounds after the first start.
    pub start: Start,
    /// Rates, resolution and when Gaussians are added.
    pub schedule: Pace,
    /// How Gaussians are added and removed.
    pub densify: Densify,
    /// Maximum number of Gaussians. `auto` is 30,000 (1,000,000 with `detail=high`), or as many a
    /// pixel where the working images are smaller because of shake.
    #[schemars(schema_with = "setting::schema::<100, 5_000_000>")]
    pub cap: Setting,
    /// Degree of the spherical harmonics.
    #[schemars(range(min = 0, max = 3))]
    pub sh_degree: u32,
    /// Background of the renders in training; delivered views have a black one.
    pub background: Background,
    /// Views held out from training: `auto` (the capture's `hold=N`, or else every 8th of 12 or
    /// more views), `none`, n for every n-th view, or names separated by commas.
    #[serde(deserialize_with = "held_out")]
    #[schemars(with = "HeldOut")]
    pub held_out: String,
    /// Source of the poses: `auto` (those of the capture if it has any, with those of a
    /// `transforms.json` refined where the photographs contradict them, or else COLMAP), `colmap`,
    /// or `given` (unchanged).
    pub pose_source: PoseSource,
    /// Key points from which structure from motion finds poses.
    pub key_points: KeyPoints,
    /// The round that is delivered.
    pub deliver: Deliver,
    /// Random seed.
    pub seed: u64,
    /// `auto`, `cpu`, or part of a Vulkan adapter's name.
    pub adapter: String,
}

/// The JSON forms of `held_out`.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged, expecting = "must be a number or a string")]
enum HeldOut {
    /// Every n-th view.
    Every(u32),
    /// `auto`, `none`, a number, or names separated by commas.
    Words(String),
}

fn held_out<'de, D: serde::Deserializer<'de>>(value: D) -> Result<String, D::Error> {
    Ok(match HeldOut::deserialize(value)? {
        HeldOut::Every(nth) => nth.to_string(),
        HeldOut::Words(words) => words,
    })
}

/// What is done about the exposure and white balance of each photograph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Exposure {
    /// Where the surfaces that photographs share agree on one gain a photograph and channel, all
    /// are brought to their mean.
    Auto,
    /// Nothing, as in the paper.
    AsTaken,
}

/// The scope of a tone table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LutScope {
    /// One histogram pooled over all views: the same tone in every view.
    Scene,
    /// One table per view: the paper's reading.
    Image,
}

/// The guide of rounds after the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Guide {
    /// A guided network receives the view and, as its guide, the view with detail of the previous
    /// round's render.
    Render,
    /// A guided network receives the view and, as its guide, the previous round's render itself at
    /// the view's brightness, as in the paper.
    Raw,
    /// No guide.
    None,
}

/// How rounds after the first start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// From the scene of the previous round, its colours mapped to the new brightness.
    Warm,
    /// From the sparse points.
    Scratch,
}

/// Where poses come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The capture's poses if it has them, else COLMAP.
    Auto,
    /// COLMAP, even if the capture has poses.
    Colmap,
    /// The capture's own poses; an error without them.
    Given,
}

/// Key points of structure from motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KeyPoints {
    /// Those of networks first, which bear more shake, then COLMAP's own.
    Auto,
    /// COLMAP's own alone; given poses are not refined.
    Colmap,
}

/// The delivered round. All rounds are kept and scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Deliver {
    /// The last one before a round that scored worse than its predecessor.
    Best,
    /// The last one, whatever its score.
    Last,
}

/// A named set of options.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The default: `high` on a GPU with enough memory, else `standard`.
    Auto,
    /// A quick look at a quarter of the pixels; hides half of the blur and the noise.
    Preview,
    /// For a processor, which trains it in minutes.
    Standard,
    /// More pixels, Gaussians and steps, for a GPU; otherwise as `standard`.
    High,
    /// What the paper states, and this build's choice where it states nothing (docs/paper.md);
    /// intended for a GPU.
    Paper,
}

/// The rounds that `auto` stands for.
pub const USUAL_ROUNDS: u32 = 2;

impl Preset {
    pub const ALL: [Self; 5] = [Self::Auto, Self::Preview, Self::Standard, Self::High, Self::Paper];

    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Preview => "preview",
            Self::Standard => "standard",
            Self::High => "high",
            Self::Paper => "paper",
        }
    }

    /// The options that the preset stands for.
    pub fn options(self) -> Options {
        let standard = Options {
            detail: Detail::Standard,
            minutes: Setting::Auto,
            rounds: Setting::Auto,
            steps: Setting::Auto,
            size: Setting::Auto,
            target: "auto".to_owned(),
            exposure: Exposure::Auto,
            lut_scope: LutScope::Scene,
            deblur: NetworkChoice::Default,
            enhance: NetworkChoice::Curve,
            guide: Guide::Render,
            noise: NoiseMode::Off,
            shake: ShakeModel::Late,
            train_on: TrainOn::Auto,
            loss: LossModel::NoiseAware,
            refine_poses: true,
            late_views: true,
            start: Start::Warm,
            schedule: Pace::Adapted,
            densify: Densify::Mcmc,
            cap: Setting::Auto,
            sh_degree: 2,
            background: Background::Random,
            held_out: "auto".to_owned(),
            pose_source: PoseSource::Auto,
            key_points: KeyPoints::Auto,
            deliver: Deliver::Best,
            seed: 0,
            adapter: "auto".to_owned(),
        };
        match self {
            Self::Auto => Options { detail: Detail::Auto, ..standard },
            Self::Preview => {
                Options { size: Setting::Given(280), cap: Setting::Given(10_000), ..standard }
            }
            Self::Standard => standard,
            Self::High => Options { detail: Detail::High, ..standard },
            Self::Paper => paper(standard),
        }
    }
}

/// The preset `paper`. docs/paper.md has the reason of each option.
fn paper(standard: Options) -> Options {
    Options {
        // The paper does not say: N + 1 cycles in its text, N in Algorithm 1 and, by its times (41,
        // 68 and 94 minutes for 2, 3 and 4 rounds), in its tables.
        rounds: Setting::Given(2),
        // The paper does not say: whether 10,000 iterations are those of a round or of the run. Its
        // times grow by as much with each round.
        steps: Setting::Given(10_000),
        size: Setting::Given(1120),
        // The paper does not say: how P_N is found.
        target: "auto-paper".to_owned(),
        exposure: Exposure::AsTaken,
        lut_scope: LutScope::Image,
        guide: Guide::Raw,
        noise: NoiseMode::Paper,
        shake: ShakeModel::Off,
        train_on: TrainOn::Deblurred,
        loss: LossModel::Plain,
        refine_poses: false,
        late_views: false,
        // The paper does not say: whether a round goes on from the previous one's scene. Algorithm
        // 1 constructs each from its views alone.
        start: Start::Scratch,
        schedule: Pace::Published,
        densify: Densify::Classic,
        // Differs from the paper: 3DGS has no cap, but memory ends. The paper's 12.17 million
        // parameters are 205,000 Gaussians beside its noise network.
        cap: Setting::Given(200_000),
        sh_degree: 3,
        background: Background::Black,
        key_points: KeyPoints::Colmap,
        deliver: Deliver::Last,
        ..standard
    }
}

impl Options {
    /// Whether a view trains as enhanced, not as deblurred. Differs from the paper for a view with
    /// a kernel: the blur that a network leaves, and the halos that it adds, do not form a kernel,
    /// and deblurring and a kernel sharpen twice.
    pub fn trains_on_enhanced(&self, has_kernel: bool) -> bool {
        match self.train_on {
            TrainOn::Auto => has_kernel,
            TrainOn::Deblurred => false,
            TrainOn::Enhanced => true,
        }
    }

    /// Number of rounds before a verdict on the shake.
    pub fn round_count(&self) -> u32 {
        self.rounds.or(USUAL_ROUNDS)
    }

    /// Optimiser steps of a round before a verdict on the shake.
    pub fn steps_per_round(&self) -> u32 {
        self.steps.or(self.detail.steps())
    }

    /// Longest side of the working images before a verdict on the shake, px.
    pub fn longest_side(&self) -> u32 {
        self.size.or(self.detail.side())
    }

    /// Largest number of Gaussians before a verdict on the shake.
    pub fn most_gaussians(&self) -> u32 {
        self.cap.or(self.detail.cap())
    }

    /// Whether the run needs no network: no view trains as deblurred, and no kernel depends on the
    /// result of deblurring.
    pub fn needs_no_network(&self) -> bool {
        self.shake != ShakeModel::Late && self.trains_on_enhanced(self.shake == ShakeModel::Kernel)
    }
}

impl Default for Options {
    fn default() -> Self {
        Preset::Standard.options()
    }
}

impl FromStr for Preset {
    type Err = OptionsError;

    fn from_str(name: &str) -> Result<Self, OptionsError> {
        Self::ALL.into_iter().find(|preset| preset.name() == name).ok_or_else(|| OptionsError {
            key: "preset".to_owned(),
            message: format!(
                "`{name}` is not a preset; choose {}",
                Self::ALL.map(Self::name).join(", ")
            ),
        })
    }
}

/// An option that does not exist or a value that is not valid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct OptionsError {
    /// The flat key at fault.
    pub key: String,
    /// What is wrong with it.
    pub message: String,
}

impl fmt::Display for OptionsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "option `{}`: {}", self.key, self.message)
    }
}

/// One of the options that name networks.
#[derive(Clone, Copy, Debug)]
pub struct NetworkOption<'a> {
    /// The flat key.
    pub key: &'static str,
    /// Its value.
    pub choice: &'a NetworkChoice,
    /// Values allowed besides `default` and the name of a network.
    pub words: &'static [NetworkChoice],
}

impl NetworkOption<'_> {
    fn check(&self) -> Result<(), OptionsError> {
        if self.choice.as_str().is_empty() {
            return Err(fault(self.key, &"is empty"));
        }
        if self.choice.is_network() || self.words.contains(self.choice) {
            return Ok(());
        }
        let words: Vec<&str> = self.words.iter().map(NetworkChoice::as_str).collect();
        let message = format!(
            "`{}` is unknown; choose one of {}, default or the name of a network",
            self.choice,
            words.join(", ")
        );
        Err(fault(self.key, &message))
    }
}

/// Options of earlier versions.
const RETIRED: [&str; 7] = [
    "deblur_unguided",
    "dropout",
    "extent",
    "fill_up",
    "resolution_schedule",
    "stereo",
    "view_colour",
];

impl Options {
    /// Whether an earlier version had an option of this name. Scripts written for it then run with
    /// a warning.
    pub fn is_retired(key: &str) -> bool {
        RETIRED.contains(&key)
    }

    /// The options with `overrides` (a JSON object of flat keys) laid over them, each checked.
    ///
    /// # Errors
    /// [`OptionsError`] naming the first key that is unknown or out of range.
    pub fn with_overrides(
        &self,
        overrides: &serde_json::Map<String, serde_json::Value>,
    ) -> Result<Self, OptionsError> {
        let mut current = self.clone();
        for (key, value) in overrides {
            let mut object = serde_json::to_value(&current).map_err(|e| fault(key, &e))?;
            let fields = object.as_object_mut().ok_or_else(|| fault(key, &"not an object"))?;
            if !fields.contains_key(key) {
                let known = fields.keys().cloned().collect::<Vec<_>>().join(", ");
                return Err(fault(key, &format!("unknown; known options are {known}")));
            }
            fields.insert(key.clone(), value.clone());
            current =
                read(object).map_err(|error| fault(key, &wanted(key).unwrap_or(error.words)))?;
        }
        current.check()?;
        Ok(current)
    }

    /// The stored options that still exist: an earlier version may have stored others.
    pub fn known(stored: &serde_json::Value) -> serde_json::Map<String, serde_json::Value> {
        let all = serde_json::to_value(Self::default()).unwrap_or_default();
        let stored = stored.as_object().into_iter().flatten();
        stored
            .filter(|(key, _)| all.get(key).is_some())
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect()
    }

    /// The options with one `key=value` of the command line laid over them. A value that does not
    /// fit as a string is parsed as JSON.
    ///
    /// # Errors
    /// [`OptionsError`] naming the key.
    pub fn with_assignment(&self, assignment: &str) -> Result<Self, OptionsError> {
        let (key, text) =
            assignment.split_once('=').ok_or_else(|| fault(assignment, &"expected key=value"))?;
        let attempt =
            |value| self.with_overrides(&serde_json::Map::from_iter([(key.to_owned(), value)]));
        let as_string = attempt(serde_json::Value::String(text.to_owned()));
        match (as_string, serde_json::from_str(text)) {
            (Err(_), Ok(value)) => attempt(value),
            (outcome, _) => outcome,
        }
    }

    /// The options that name networks.
    pub fn networks(&self) -> [NetworkOption<'_>; 2] {
        use NetworkChoice::{Curve, Identity};
        let option = |key, choice, words| NetworkOption { key, choice, words };
        [option("deblur", &self.deblur, &[Identity]), option("enhance", &self.enhance, &[Curve])]
    }

    fn check(&self) -> Result<(), OptionsError> {
        within("minutes", self.minutes.or(1))?;
        within("rounds", self.round_count())?;
        within("steps", self.steps_per_round())?;
        within("size", self.longest_side())?;
        self.networks().iter().try_for_each(NetworkOption::check)?;
        if self.enhance != NetworkChoice::Curve && self.target != "auto" {
            let message =
                "a network that brightens decides the brightness; leave `target` at `auto`";
            return Err(fault("target", &message));
        }
        within("cap", self.most_gaussians())?;
        within("sh_degree", self.sh_degree)
    }
}

/// The options that are numbers, with their least and greatest values.
const RANGES: [(&str, u32, u32); 6] = [
    ("minutes", 1, 1_440),
    ("rounds", 1, 8),
    ("steps", 1, 200_000),
    ("size", 64, 4096),
    ("cap", 100, 5_000_000),
    ("sh_degree", 0, 3),
];

fn range(key: &str) -> Option<(u32, u32)> {
    RANGES.iter().find(|(name, ..)| *name == key).map(|&(_, low, high)| (low, high))
}

fn within(key: &str, value: u32) -> Result<(), OptionsError> {
    match range(key) {
        Some((low, high)) if !(low..=high).contains(&value) => {
            Err(fault(key, &format!("{value} is outside {low}..={high}")))
        }
        _ => Ok(()),
    }
}

/// The range that a numeric option allows, in words; `None` for other options.
fn wanted(key: &str) -> Option<String> {
    let (low, high) = range(key)?;
    let or_auto = if key == "sh_degree" { "" } else { ", or `auto`" };
    Some(format!("must be a whole number from {low} to {high}{or_auto}"))
}

fn fault(key: &str, message: &dyn fmt::Display) -> OptionsError {
    OptionsError { key: key.to_owned(), message: message.to_string() }
}

#[cfg(test)]
mod tests;
