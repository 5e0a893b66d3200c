//! How long a run will take on this machine, by the pace of its last runs.

use super::work::{Job, Part, Photographs, Work};
use super::{By, History};
use crate::capture::Capture;
use crate::event::Stage;
use crate::metrics::CaptureShake;
use crate::pipeline::config::{Options, PoseSource, Setting};
use crate::pipeline::tools::Tools;
use crate::pipeline::views::working_size;
use crate::pipeline::workspace::Workspace;

/// Predicts the time of runs over some photographs with some tools on this machine.
pub struct Forecast {
    /// Width and height of the photographs, px.
    sizes: Vec<[usize; 2]>,
    has_poses: bool,
    on_gpu: bool,
    by: By,
    history: History,
}

/// Largest share of an expected time that may rest on guesses without a warning.
const MOST_GUESSED: f64 = 0.1;

/// The time that something is expected to take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected {
    pub seconds: f64,
    /// Whether this machine has done its parts before, but for small ones. For the others
    /// [`Part::first_pace`] stands in.
    pub is_known: bool,
}

/// The rounds of a run, once its photographs have been looked at.
#[derive(Clone, Copy, Debug)]
pub struct Rounds {
    pub rounds: u32,
    /// Views with a pose.
    pub views: u32,
    pub shake: Option<CaptureShake>,
    /// Longest side of the working images, px.
    pub size: u32,
}

impl Forecast {
    pub fn new(capture: &Capture, tools: &Tools<'_>, workspace: &Workspace) -> Self {
        let network = tools.networks().deblur;
        let by = By {
            adapter: tools.device.to_string(),
            network: format!("{} on {}", network.id, network.provider),
            poses: tools.sfm.describe(),
        };
        Self {
            sizes: capture.views.iter().map(|view| [view.width, view.height]).collect(),
            has_poses: capture.poses.is_some(),
            on_gpu: tools.device.is_gpu(),
            by,
            history: History::open(tools.cache.as_deref(), workspace),
        }
    }

    /// Of photographs of `sizes` with poses, on a machine with this history of unnamed tools.
    #[cfg(test)]
    pub fn on(sizes: Vec<[usize; 2]>, history: History) -> Self {
        Self { sizes, has_poses: true, on_gpu: false, by: By::default(), history }
    }

    /// Width and height of the photographs, px.
    pub fn sizes(&self) -> &[[usize; 2]] {
        &self.sizes
    }

    fn photographs(&self, options: &Options) -> Photographs {
        let size = options.longest_side() as usize;
        let sizes = self.sizes.iter().map(|&[width, height]| working_size(width, height, size));
        Photographs {
            views: self.sizes.len(),
            pixels: sizes.clone().map(|(width, height)| width * height).sum(),
            longest: sizes.map(|(width, height)| width.max(height) as u32).max().unwrap_or(0),
        }
    }

    /// A plan of the run, which follows its events.
    pub fn plan(&self, options: &Options) -> super::Plan {
        let (by, history) = (self.by.clone(), self.history.clone());
        super::Plan::new(options, self.photographs(options), by, history)
    }

    /// The time of a run with these options, before anything is known of the photographs.
    pub fn run(&self, options: &Options) -> Expected {
        let mut job = Job::new(options, self.photographs(options));
        if !self.has_poses || options.pose_source == PoseSource::Colmap {
            job.search();
        }
        self.of(&job.stages().into_iter().flat_map(|(round, stage)| job.of(stage, round)).collect())
    }

    /// The time of the rounds alone, with the options in effect.
    pub fn rounds(&self, options: &Options, rounds: Rounds) -> Expected {
        let job = self.job(options, rounds);
        let stages = job.stages().into_iter().filter(|(round, _)| *round > 0);
        self.of(&stages.flat_map(|(round, stage)| job.of(stage, round)).collect())
    }

    /// The time of a round in training and of what follows it, with the options in effect.
    pub fn rest(&self, options: &Options, rounds: Rounds, round: u32) -> Rest<'_> {
        Rest { forecast: self, job: self.job(options, rounds), round }
    }

    fn job(&self, options: &Options, rounds: Rounds) -> Job {
        let Rounds { rounds, views, shake, size } = rounds;
        let steps = Some(options.steps_per_round());
        let options = Options { size: Setting::Given(size), ..options.clone() };
        let mut job = Job::new(&options, self.photographs(&options));
        job.replan(rounds, views, shake, Some(size), steps);
        job
    }

    /// Seconds of a part for a unit of its work, if this machine has done it before.
    fn known_pace(&self, part: Part) -> Option<f64> {
        self.history.pace(part, self.by.of(part))
    }

    fn seconds(&self, (part, work): &(Part, f64)) -> f64 {
        work * self
            .known_pace(*part)
            .unwrap_or_else(|| part.first_pace(self.on_gpu, rayon::current_num_threads()))
    }

    fn of(&self, work: &Work) -> Expected {
        let unknown = work.iter().filter(|(part, _)| self.known_pace(*part).is_none());
        let unknown: f64 = unknown.map(|one| self.seconds(one)).sum();
        let seconds = work.iter().map(|one| self.seconds(one)).sum();
        Expected { seconds, is_known: unknown <= MOST_GUESSED * seconds }
    }

    fn steps_and_other(&self, work: Work) -> [f64; 2] {
        let (steps, other): (Work, Work) =
            work.into_iter().partition(|(part, _)| *part == Part::Steps);
        [steps, other].map(|work| self.of(&work).seconds)
    }
}

/// The time of a round in training and of what follows it.
pub struct Rest<'a> {
    forecast: &'a Forecast,
    job: Job,
    round: u32,
}

impl Rest<'_> {
    /// Seconds of the round's training before step `until`, and after the last step: of its steps,
    /// and of what is between them.
    pub fn training(&self, until: u32) -> [f64; 2] {
        self.forecast.steps_and_other(self.job.training(self.round, until))
    }

    /// Seconds of what follows the training: of steps in later rounds, and of all else.
    pub fn after(&self) -> [f64; 2] {
        let is_later = |(round, stage): &(u32, Stage)| {
            *round > self.round || (*round == self.round && *stage > Stage::Reconstruct)
        };
        let later = self.job.stages().into_iter().filter(is_later);
        let work = later.flat_map(|(round, stage)| self.job.of(stage, round));
        self.forecast.steps_and_other(work.collect())
    }
}
