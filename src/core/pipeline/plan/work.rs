//! The work of a run by its parts, in seconds that two cores with software Vulkan take.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::event::Stage;
use crate::features::SearchOptions;
use crate::metrics::CaptureShake;
use crate::pipeline::config::{NoiseMode, Options, Pace, Setting, Start};
use crate::pipeline::effective::{Sizes, in_effect};
use crate::pipeline::shaken;
use crate::pipeline::views::HELD_OUT_FROM;
use crate::reconstruct::{CORRECTIONS, Schedule};

/// The parts of a run whose speeds differ from machine to machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Structure from motion without a search.
    Poses,
    /// Matching pairs of photographs by networks.
    Pairs,
    /// Models from those pairs.
    Mapping,
    /// Structure from motion with COLMAP's own features.
    Features,
    Enhance,
    /// The network, and the look at the shake that it removed.
    Deblur,
    /// The steps of training.
    Steps,
    /// Solving for kernels between steps.
    Kernels,
    /// Correcting cameras between steps, and of held-out views after them.
    Cameras,
    Render,
    Match,
    Evaluate,
}

impl Part {
    /// The parts of training.
    pub const TRAINING: [Self; 3] = [Self::Steps, Self::Kernels, Self::Cameras];

    /// Assumed seconds per unit of work on a machine that has not run this part yet: on a GPU, or
    /// on this many threads of a processor, scaled from a measurement on two.
    pub fn first_pace(self, on_gpu: bool, threads: usize) -> f64 {
        let on_two = match self {
            Self::Steps | Self::Kernels | Self::Cameras | Self::Render if on_gpu => return 0.02,
            Self::Steps | Self::Cameras => 0.4,
            Self::Kernels | Self::Render | Self::Match => 0.8,
            Self::Poses => 0.1,
            Self::Pairs | Self::Mapping | Self::Features => 1.0,
            Self::Evaluate => 1.5,
            Self::Deblur => 1.8,
            Self::Enhance => 3.0,
        };
        2.0 * on_two / threads as f64
    }
}

/// Seconds that something takes on two cores: alone, for a megapixel and for 1,000 Gaussians.
struct Price(f64, f64, f64);

/// A pair of photographs: its share of poses without a search.
const PAIR: Price = Price(0.0, 1.5, 0.0);
/// In the search for poses: a pair with the most key points, a photograph in models, and a pair by
/// COLMAP's own features. The copies of photographs have one size.
const MATCHED_PAIR: f64 = 0.4;
const MAPPED_VIEW: f64 = 0.5;
const FEATURED_PAIR: f64 = 0.1;
/// The stages of a view.
const ENHANCE: Price = Price(0.001, 0.03, 0.0);
const DEBLUR: Price = Price(0.002, 0.4, 0.0);
const RENDER: Price = Price(0.002, 0.12, 0.0005);
const MATCH: Price = Price(0.002, 0.15, 0.0);
const EVALUATE: Price = Price(0.002, 0.6, 0.0);
/// A step, a kernel and a corrected camera.
const STEP: Price = Price(0.001, 0.23, 0.003);
const KERNEL: Price = Price(0.0, 0.14, 0.001);
const CAMERA: Price = Price(0.0, 0.66, 0.0075);
/// More for a megapixel of a step and of a corrected camera where the view has a kernel.
const BLURRED_STEP: f64 = 0.11;
const BLURRED_CAMERA: f64 = 0.9;
/// Share of that work in a correction that another follows.
const COARSE_CAMERA: f64 = 0.55;
/// Times as long as a step takes with the noise field.
const NOISE: f64 = 30.0;

/// A cold round begins with few Gaussians and has all before half of it, as
/// [`crate::reconstruct::densify`] makes them: the share that there is at the start, and where
/// growth begins and ends.
const FIRST_SHARE: f64 = 0.25;
const GROWTH: (f64, f64) = (0.05, 0.425);

/// Share of the training views of a shaken capture that have a kernel, until a round shows which.
const KERNELS: f64 = 0.6;

/// Work of some parts, s.
pub type Work = Vec<(Part, f64)>;

/// The photographs of a run at the size asked for.
#[derive(Clone, Copy, Debug)]
pub struct Photographs {
    /// How many there are.
    pub views: usize,
    /// Pixels of all.
    pub pixels: usize,
    /// Longest side, px.
    pub longest: u32,
}

/// The facts that decide the work of a run.
#[derive(Clone, Debug)]
pub struct Job {
    asked: Options,
    /// The options in effect once the shake is known.
    options: Options,
    rounds: u32,
    views: f64,
    /// Mean of a working image.
    megapixels: f64,
    /// Longest sides of the working images.
    sizes: Sizes,
    /// Photographs and pairs of them that structure from motion counts, once known.
    pairs: Option<u64>,
    /// Whether poses are searched for.
    searches: bool,
    /// Views with a kernel in the next round, once known.
    kernels: Option<f64>,
    /// Steps of the rounds that have been in training; a time limit changes them.
    trained: BTreeMap<u32, u32>,
}

impl Job {
    /// A run over photographs, as they are at the size asked for.
    pub fn new(options: &Options, photographs: Photographs) -> Self {
        let Photographs { views, pixels, longest } = photographs;
        Self {
            asked: options.clone(),
            options: options.clone(),
            rounds: options.round_count(),
            views: views as f64,
            megapixels: pixels as f64 / 1e6 / views.max(1) as f64,
            sizes: Sizes { before: longest, now: longest },
            pairs: None,
            searches: false,
            kernels: None,
            trained: BTreeMap::new(),
        }
    }

    /// Another number of rounds or views, a verdict on the shake, another size or number of steps.
    pub fn replan(
        &mut self,
        rounds: u32,
        views: u32,
        shake: Option<CaptureShake>,
        size: Option<u32>,
        steps: Option<u32>,
    ) {
        (self.rounds, self.views) = (rounds, f64::from(views));
        if let Some(steps) = steps {
            self.asked.steps = Setting::Given(steps);
            self.options.steps = self.asked.steps;
        }
        if shake.is_some() {
            let last = self.sizes.now;
            self.sizes.now = size.unwrap_or(last);
            self.options = in_effect(&self.asked, shake, Some(self.sizes));
            self.megapixels *= (f64::from(self.sizes.now) / f64::from(last.max(1))).powi(2);
        }
    }

    /// Notes that poses are searched for.
    pub fn search(&mut self) {
        self.searches = true;
    }

    /// Notes how many photographs and pairs structure from motion counts.
    pub fn count_pairs(&mut self, total: u64) {
        self.pairs = Some(total);
    }

    /// Number of photographs.
    pub fn photographs(&self) -> u64 {
        self.views as u64
    }

    /// The work of matching one pair, which grows with the square of its key points.
    pub fn pair(&self) -> f64 {
        let options = SearchOptions::default();
        let pairs = self.all_pairs() - self.views;
        let share = options.key_points_of(pairs as usize) as f64 / options.key_points as f64;
        MATCHED_PAIR * share * share
    }

    /// Photographs and pairs.
    fn all_pairs(&self) -> f64 {
        let all = self.views * (self.views + 1.0) / 2.0;
        self.pairs.map_or(all, |pairs| pairs as f64)
    }

    /// Notes how many views have a kernel in the next round.
    pub fn expect_kernels(&mut self, kernels: u32) {
        self.kernels = Some(f64::from(kernels));
    }

    /// Notes how many steps a round in training has.
    pub fn train(&mut self, round: u32, steps: u32) {
        self.trained.insert(round, steps);
    }

    /// Steps of a round.
    pub fn steps(&self, round: u32) -> u32 {
        self.trained.get(&round).copied().unwrap_or(self.options.steps_per_round())
    }

    /// The planned stages in order.
    pub fn stages(&self) -> Vec<(u32, Stage)> {
        let mut stages = vec![(0, Stage::Poses)];
        if self.asked.enhance.is_network() {
            stages.push((0, Stage::Enhance));
        }
        if shaken::is_needed(&self.asked) {
            stages.push((0, Stage::Deblur));
        }
        for round in 1..=self.rounds {
            let is_last = round == self.rounds;
            let of_round = Stage::ALL[1..].iter();
            let of_round = of_round.filter(|stage| !(is_last && **stage == Stage::Match));
            stages.extend(of_round.map(|stage| (round, *stage)));
        }
        stages
    }

    /// The work of a stage; none of a search for late views, which cannot be foreseen.
    pub fn of(&self, stage: Stage, round: u32) -> Work {
        let views = |part, price| vec![(part, self.views * self.seconds(price, 1.0, 1.0))];
        match stage {
            Stage::Poses if round > 0 => Work::new(),
            Stage::Poses if self.searches => vec![
                (Part::Pairs, (self.all_pairs() - self.views) * self.pair()),
                (Part::Mapping, self.views * MAPPED_VIEW),
                (Part::Features, self.all_pairs() * FEATURED_PAIR),
            ],
            Stage::Poses => {
                vec![(Part::Poses, self.all_pairs() * self.seconds(&PAIR, 1.0, 1.0))]
            }
            Stage::Enhance => views(Part::Enhance, &ENHANCE),
            Stage::Deblur if round == 0 => {
                let side = f64::from(shaken::VERDICT_SIDE) / f64::from(self.sizes.now.max(1));
                let pixels = side.min(1.0).powi(2);
                vec![(Part::Deblur, self.views * self.seconds(&DEBLUR, pixels, 1.0))]
            }
            Stage::Deblur => views(Part::Deblur, &DEBLUR),
            Stage::Reconstruct => self.training(round, self.steps(round)),
            Stage::Render => views(Part::Render, &RENDER),
            Stage::Match => views(Part::Match, &MATCH),
            Stage::Evaluate => views(Part::Evaluate, &EVALUATE),
        }
    }

    /// Seconds of something, for these shares of a view's pixels and of all Gaussians.
    fn seconds(&self, price: &Price, pixels: f64, gaussians: f64) -> f64 {
        let Price(alone, per_megapixel, per_thousand) = price;
        let thousands = f64::from(self.options.most_gaussians()) / 1e3;
        alone + per_megapixel * self.megapixels * pixels + per_thousand * thousands * gaussians
    }

    /// The work of a round's training before step `until`, and after the last step.
    pub fn training(&self, round: u32, until: u32) -> Work {
        let options = &self.options;
        let schedule = Schedule {
            steps: self.steps(round),
            sh_degree: options.sh_degree,
            resolution: options.schedule == Pace::Adapted,
            pace: options.schedule,
            warm: round > 1 && options.start == Start::Warm,
            seed: 0,
        };
        let noise = match options.noise {
            NoiseMode::Off => 1.0,
            NoiseMode::Paper => NOISE,
        };
        let held_out = self.held_out();
        let with_kernel = self.kernels_of(round);
        let kernels = with_kernel * self.seconds(&KERNEL, 1.0, 1.0);
        let blurred = with_kernel / (self.views * (1.0 - held_out)) * self.megapixels;
        let cameras = if options.refine_poses {
            self.views * (self.seconds(&CAMERA, 1.0, 1.0) + BLURRED_CAMERA * blurred)
        } else {
            0.0
        };
        let mut work = [0.0; 3];
        for step in 0..until.min(schedule.steps) {
            let side = 1.0 / schedule.divisor(step) as f64;
            let (from, to) = GROWTH;
            let grown = ((schedule.share(step) - from) / (to - from)).clamp(0.0, 1.0);
            let gaussians = if schedule.warm { 1.0 } else { FIRST_SHARE.powf(1.0 - grown) };
            let plain = self.seconds(&STEP, side * side, gaussians);
            work[0] += noise * (plain + BLURRED_STEP * blurred * side * side);
            if schedule.estimates_shake(step) {
                work[1] += kernels;
            }
            if schedule.refines_poses(step) {
                let is_last = schedule.refines_poses_last(step);
                let share = if is_last { 1.0 } else { COARSE_CAMERA };
                work[2] += share * (1.0 - held_out) * cameras;
            }
        }
        if until >= schedule.steps {
            let corrections = 1.0 + COARSE_CAMERA * f64::from(CORRECTIONS - 1);
            work[2] += corrections * held_out * cameras;
        }
        Part::TRAINING.into_iter().zip(work).collect()
    }

    /// Share of the views that train nothing.
    fn held_out(&self) -> f64 {
        match self.options.held_out.as_str() {
            "none" => 0.0,
            "auto" if self.views < HELD_OUT_FROM as f64 => 0.0,
            every => {
                let every = every.parse().ok().filter(|every| *every >= 2.0);
                1.0 / every.unwrap_or(8.0)
            }
        }
    }

    /// Views with a kernel in a round.
    fn kernels_of(&self, round: u32) -> f64 {
        let training = self.views * (1.0 - self.held_out());
        let expected = if self.options.shake.has_kernel(false) {
            training
        } else if round == 1 || !self.options.shake.has_kernel(true) {
            0.0
        } else {
            self.kernels.unwrap_or(KERNELS * training)
        };
        expected.min(training)
    }
}
