//! Progress and time left: the work of the stages to come, by the pace of this machine in its last
//! runs and in this one.

mod forecast;
mod history;
mod reporter;
mod search;
mod work;

use std::collections::BTreeMap;

use super::config::Options;
use crate::camera::Split;
use crate::event::{Event, Stage};
use crate::metrics::{RoundMetrics, ViewScore};
pub use forecast::{Expected, Forecast, Rounds};
use history::Cost;
pub use history::History;
pub use reporter::ProgressReporter;
use search::Trial;
use work::{Job, Part, Photographs, Work};

/// Share of a stage whose pace weighs as much as that of earlier runs.
const KNOWN_SHARE: f64 = 0.2;
/// Share of a stage after which the pace of two cores, which may be far from this machine's, no
/// longer counts.
const GUESSED_SHARE: f64 = 0.1;
/// Least rise of the time left within a stage that is reported: steps scatter.
const MIN_RISE: f64 = 1.3;

/// The tools of a run, by the speed of which parts differ.
#[derive(Clone, Debug, Default)]
pub struct By {
    pub adapter: String,
    pub network: String,
    pub poses: String,
}

impl By {
    fn of(&self, part: Part) -> &str {
        match part {
            Part::Poses | Part::Pairs | Part::Mapping | Part::Features => &self.poses,
            Part::Deblur => &self.network,
            _ => &self.adapter,
        }
    }
}

/// Follows the events of a run.
#[derive(Clone, Debug)]
pub struct Plan {
    job: Job,
    history: History,
    by: By,
    /// Work and seconds by round and part, of this run.
    measured: BTreeMap<(u32, Part), (f64, f64)>,
    done: Vec<(u32, Stage)>,
    running: Option<Running>,
    /// The strategy that the search for poses tries.
    trial: Option<Trial>,
    /// The number of strategies tried, with that one.
    trials: u32,
    /// Times as long as usual on this machine, as the pairs of this run have shown.
    slowness: f64,
    progress: f64,
    eta: Option<f64>,
}

/// The stage that runs.
#[derive(Clone, Copy, Debug)]
struct Running {
    stage: Stage,
    round: u32,
    began: f64,
    /// Share and time of the first report, before which an earlier process may have made a part.
    first: Option<(f64, f64)>,
    /// Share and time of the last report.
    last: (f64, f64),
    /// Whether its time counts: an earlier run did not make its result.
    counts: bool,
}

impl Running {
    /// Seconds of the whole stage at its own pace, which replaces what was `expected` as it goes
    /// on.
    fn total(&self, expected: f64, is_known: bool) -> f64 {
        let (first, since) = self.first.unwrap_or(self.last);
        let (share, seconds) = (self.last.0 - first, self.last.1 - since);
        let weight = if is_known {
            KNOWN_SHARE
        } else {
            KNOWN_SHARE * (GUESSED_SHARE - share).max(f64::EPSILON)
        };
        if expected > 0.0 {
            (weight * expected + seconds) / (weight + share)
        } else if share > 0.0 {
            seconds / share
        } else {
            0.0
        }
    }

    /// Whether it is the search for poses before the rounds, and not over.
    fn seeks_poses(&self) -> bool {
        self.stage == Stage::Poses && self.round == 0 && self.last.0 < 1.0
    }
}

/// How far a stage is.
struct Advanced {
    stage: Stage,
    done: u64,
    total: u64,
    /// Steps a second.
    per_second: Option<f64>,
}

impl Plan {
    /// Plan for photographs, as they are at the size asked for.
    pub fn new(options: &Options, photographs: Photographs, by: By, history: History) -> Self {
        Self {
            job: Job::new(options, photographs),
            history,
            by,
            measured: BTreeMap::new(),
            done: Vec::new(),
            running: None,
            trial: None,
            trials: 0,
            slowness: 1.0,
            progress: 0.0,
            eta: None,
        }
    }

    /// Takes an event at a time in seconds; returns whether progress has changed enough to report.
    pub fn take(&mut self, at: f64, event: &Event) -> bool {
        match event {
            Event::Planned { rounds, views, shake, size, steps } => {
                self.job.replan(*rounds, *views, *shake, *size, *steps);
            }
            Event::StageStarted { stage, round } => {
                self.close(at);
                (self.eta, self.trials) = (None, 0);
                self.running = Some(Running {
                    stage: *stage,
                    round: *round,
                    began: at,
                    first: None,
                    last: (0.0, at),
                    counts: true,
                });
            }
            Event::StrategyStarted { strategy, .. } => {
                self.end_trial(at);
                self.eta = None;
                self.job.search();
                self.trials += 1;
                self.trial = Some(Trial::new(self.trials, *strategy, at));
            }
            Event::StageAdvanced { stage, done, total, steps_per_second, .. } => {
                let advanced = Advanced {
                    stage: *stage,
                    done: *done,
                    total: *total,
                    per_second: *steps_per_second,
                };
                self.advance(at, &advanced);
            }
            Event::StageFinished { skipped, .. } => {
                if let Some(running) = &mut self.running {
                    running.last = (1.0, at);
                    running.counts &= !skipped;
                }
            }
            Event::RoundFinished { metrics } => {
                self.learn(metrics);
                return false;
            }
            Event::Finished { .. } => self.end(at),
            _ => return false,
        }
        self.estimate(at);
        true
    }

    fn advance(&mut self, at: f64, event: &Advanced) {
        let Some(mut running) = self.running.filter(|running| running.stage == event.stage) else {
            return;
        };
        if self.trial.is_some() {
            // Its pairs and thirds are no share of the search.
            self.count(at, event);
            return;
        }
        let share = match event.stage {
            // Steps on small images are cheaper, and there is work between them.
            Stage::Reconstruct => {
                self.job.train(running.round, event.total as u32);
                let before = self.job.training(running.round, event.done as u32);
                self.seconds(&before) / self.seconds(&self.job.of(event.stage, running.round))
            }
            _ => event.done as f64 / event.total.max(1) as f64,
        };
        // More steps than its time allows: an earlier process made some of them.
        if event.per_second.is_some_and(|rate| event.done as f64 / rate > at - running.began) {
            running.counts = false;
        }
        // A tool that tries another way begins to count anew.
        if share > running.last.0 {
            running.first.get_or_insert((share, at));
            running.last = (share, at);
        }
        self.running = Some(running);
    }

    /// Notes how many pairs the search for poses has matched.
    fn count(&mut self, at: f64, event: &Advanced) {
        let Some(trial) = &mut self.trial else {
            return;
        };
        trial.count(at, event.done, event.total, self.job.photographs());
        let pace = trial.pace();
        if let Some(total) = trial.total() {
            self.job.count_pairs(total);
        }
        let usual = self.history.pace(Part::Pairs, self.by.of(Part::Pairs));
        if let (Some(pace), Some(usual)) = (pace, usual) {
            self.slowness = search::slowness(pace, usual * self.job.pair());
        }
    }

    /// The strategy that was tried is over: its parts cost what it took.
    fn end_trial(&mut self, at: f64) {
        let Some(trial) = self.trial.take() else {
            return;
        };
        let work = self.job.of(Stage::Poses, 0);
        let of = |part| work.iter().find(|(other, _)| *other == part).map(|(_, work)| *work);
        let own = trial.part.and_then(|part| Some((part, (of(part)?, trial.seconds(at)))));
        let pairs = trial
            .pairs()
            .map(|(pairs, seconds)| (Part::Pairs, (pairs as f64 * self.job.pair(), seconds)));
        self.measured
            .extend({ own.into_iter().chain(pairs) }.map(|(part, cost)| ((0, part), cost)));
    }

    /// The stage that ran is over. Its time includes that up to the next stage.
    fn close(&mut self, at: f64) {
        let has_searched = self.trial.is_some();
        self.end_trial(at);
        let Some(running) = self.running.take() else {
            return;
        };
        let work = self.job.of(running.stage, running.round);
        let expected = self.seconds(&work);
        if running.counts && expected > 0.0 && !has_searched {
            let drift = (at - running.began) / expected;
            let cost = |(part, work)| (part, (work, drift * work * self.pace(part)));
            let costs: Vec<_> = work.into_iter().map(cost).collect();
            let costs = costs.into_iter();
            self.measured.extend(costs.map(|(part, cost)| ((running.round, part), cost)));
        }
        self.done.push((running.round, running.stage));
    }

    /// Tells the parts of a round's training apart.
    fn learn(&mut self, metrics: &RoundMetrics) {
        let has_kernel =
            |view: &&ViewScore| view.split == Some(Split::Train) && view.is_shaken == Some(true);
        let kernels = metrics.views.iter().filter(has_kernel).count();
        self.job.expect_kernels(kernels as u32);
        let Some(between) = metrics.between else {
            return;
        };
        let stepping = metrics.steps as f64 / metrics.steps_per_second;
        let of = |part| self.measured.get(&(metrics.round, part));
        let whole: f64 =
            { Part::TRAINING.into_iter().filter_map(of) }.map(|(_, seconds)| seconds).sum();
        let seconds = [
            stepping - between.kernels - between.cameras,
            between.kernels,
            between.cameras + whole - stepping,
        ];
        for (part, seconds) in Part::TRAINING.into_iter().zip(seconds) {
            if let Some(cost) = self.measured.get_mut(&(metrics.round, part)) {
                cost.1 = seconds.max(0.0);
            }
        }
    }

    /// The run is over: the next one learns from it.
    fn end(&mut self, at: f64) {
        self.close(at);
        let mut parts: BTreeMap<Part, (f64, f64)> = BTreeMap::new();
        for ((_, part), (work, seconds)) in &self.measured {
            let sum = parts.entry(*part).or_default();
            *sum = (sum.0 + work, sum.1 + seconds);
        }
        let cost =
            |(part, (work, seconds))| Cost { part, by: self.by.of(part).to_owned(), work, seconds };
        self.history.add(parts.into_iter().map(cost).collect());
        (self.progress, self.eta) = (1.0, Some(0.0));
    }

    /// Reckons progress and time left.
    fn estimate(&mut self, at: f64) {
        let Some(running) = self.running else {
            return;
        };
        let work = self.job.of(running.stage, running.round);
        let expected = self.seconds(&work);
        let mut parts = work.iter().filter(|(_, work)| *work > 0.0);
        let is_known = parts.all(|(part, _)| self.known_pace(*part).is_some());
        let trial = self.trial.as_ref().filter(|_| running.seeks_poses());
        let left = if running.seeks_poses() { self.left_of_search(at) } else { None };
        let (total, done) = match trial {
            Some(_) => {
                let done = at - running.began;
                let rest = left.unwrap_or_else(|| search::vague_rest(done, expected));
                (done + rest, done)
            }
            None => {
                let total = running.total(expected, is_known);
                (total, total * running.last.0)
            }
        };
        let (mut before, mut after) = (0.0, 0.0);
        for (round, stage) in self.job.stages() {
            let seconds = self.seconds(&self.job.of(stage, round));
            if self.done.contains(&(round, stage)) {
                before += seconds;
            } else if (round, stage) != (running.round, running.stage) {
                let drifts = stage == running.stage && expected > 0.0;
                after += seconds * if drifts { total / expected } else { 1.0 };
            }
        }
        let progress = (before + done) / (before + total + after);
        if progress.is_finite() {
            self.progress = self.progress.max(progress.min(1.0));
        }
        let left = if running.seeks_poses() { left } else { Some(total - done) };
        let eta = left.map(|left| left + after);
        self.eta = match (self.eta, eta) {
            (Some(reported), Some(eta)) if eta > reported && eta < MIN_RISE * reported => {
                Some(reported)
            }
            _ => eta,
        };
    }

    /// Seconds left of the search for poses: pairs by their pace in this run, the rest by earlier
    /// runs.
    fn left_of_search(&self, at: f64) -> Option<f64> {
        let work = self.job.of(Stage::Poses, 0);
        let usual = |part| {
            let (_, work) = work.iter().find(|(other, _)| *other == part)?;
            Some(work * self.known_pace(part)?)
        };
        self.trial.as_ref()?.left(at, usual)
    }

    /// Seconds of a part for a unit of its work: of this run, or of this machine's last ones.
    fn known_pace(&self, part: Part) -> Option<f64> {
        let costs = self.measured.iter().filter(|((_, other), _)| *other == part);
        let (work, seconds) =
            costs.fold((0.0, 0.0), |sum, (_, (work, seconds))| (sum.0 + work, sum.1 + seconds));
        let here = (work > 0.0).then(|| seconds / work);
        let before = || Some(self.slowness * self.history.pace(part, self.by.of(part))?);
        here.or_else(before)
    }

    /// That of two cores where nothing is known.
    fn pace(&self, part: Part) -> f64 {
        self.known_pace(part).unwrap_or(1.0)
    }

    fn seconds(&self, work: &Work) -> f64 {
        let of = |(part, work): &(Part, f64)| work * self.pace(*part);
        work.iter().map(of).sum()
    }

    /// Progress and time left as an event.
    pub fn event(&self) -> Event {
        Event::Progress { progress: self.progress, eta_seconds: self.eta }
    }

    pub fn history(&self) -> &History {
        &self.history
    }
}

#[cfg(test)]
mod tests;
