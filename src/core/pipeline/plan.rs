//! Progress and remaining time: weights from costs measured on two cores, corrected by the time
//! that the run has taken so far.

use std::time::Instant;

use super::config::{NoiseMode, Options};
use crate::deblur::NetworkChoice;
use crate::event::{Event, ProgressSink, Stage};

/// Expected seconds of each stage; only their ratios matter once the run is under way.
#[derive(Clone, Debug)]
pub struct Plan {
    poses: f64,
    /// The part of `poses` that is still to do; 0 once the poses are found.
    poses_left: f64,
    round: Vec<(Stage, f64)>,
    rounds: u32,
    /// Whether a network brightens the views once before the rounds.
    brightens: bool,
    done: f64,
    current: f64,
    skipped: f64,
    started: Instant,
}

impl Plan {
    /// Plan for `views` working images of `pixels` each.
    pub fn new(options: &Options, views: usize, pixels: usize) -> Self {
        let (views, megapixels) = (views as f64, pixels as f64 / 1e6);
        let noise = match options.noise {
            NoiseMode::Off => 1.0,
            NoiseMode::Paper => 30.0,
        };
        let splats = f64::from(options.cap) / 1e5;
        let step = (0.02 + 0.8 * megapixels + 0.15 * splats) * noise;
        let round = vec![
            (Stage::Enhance, 0.05 * views * megapixels.max(0.05)),
            (Stage::Deblur, 0.6 * views * megapixels),
            (Stage::Reconstruct, step * f64::from(options.steps)),
            (Stage::Render, 0.6 * views * megapixels),
            (Stage::Evaluate, 1.5 * views * megapixels),
            (Stage::Match, 1.0),
        ];
        Self {
            poses: 2.2 * views,
            poses_left: 2.2 * views,
            round,
            rounds: options.rounds,
            brightens: options.enhance != NetworkChoice::Curve,
            done: 0.0,
            current: 0.0,
            skipped: 0.0,
            started: Instant::now(),
        }
    }

    /// Changes the planned number of rounds.
    pub fn set_rounds(&mut self, rounds: u32) {
        self.rounds = rounds;
    }

    /// Multiplies the planned steps of each round.
    pub fn multiply_steps(&mut self, times: f64) {
        let train = self.round.iter_mut();
        for (_, weight) in train.filter(|(stage, _)| *stage == Stage::Reconstruct) {
            *weight *= times;
        }
    }

    fn weight(&self, stage: Stage) -> f64 {
        if stage == Stage::Poses {
            return self.poses_left;
        }
        self.round
            .iter()
            .find(|(other, _)| *other == stage)
            .map_or(0.0, |(_, weight)| *weight)
    }

    fn total(&self) -> f64 {
        let before = if self.brightens {
            self.weight(Stage::Enhance)
        } else {
            0.0
        };
        self.poses
            + before
            + f64::from(self.rounds) * self.round.iter().map(|(_, weight)| weight).sum::<f64>()
    }

    /// Records that `share` (0..=1) of a stage is done, and reports progress.
    pub fn advance(&mut self, stage: Stage, share: f64, sink: &mut dyn ProgressSink) {
        self.current = self.weight(stage) * share.clamp(0.0, 1.0);
        self.tell(sink);
    }

    /// Records that a stage is over. `skipped` work does not count towards the run's speed.
    pub fn finish(&mut self, stage: Stage, skipped: bool, sink: &mut dyn ProgressSink) {
        let weight = self.weight(stage);
        if stage == Stage::Poses {
            // Late views may be searched for after every round; the plan does not include them.
            self.poses_left = 0.0;
        }
        self.done += weight;
        self.current = 0.0;
        if skipped {
            self.skipped += weight;
        }
        self.tell(sink);
    }

    fn tell(&self, sink: &mut dyn ProgressSink) {
        let reached = self.done + self.current;
        let progress = (reached / self.total()).clamp(0.0, 1.0);
        let worked = reached - self.skipped;
        let elapsed = self.started.elapsed().as_secs_f64();
        let eta_seconds = (worked > 0.0 && elapsed > 2.0)
            .then(|| (self.total() - reached).max(0.0) * elapsed / worked);
        sink.event(&Event::Progress {
            progress,
            eta_seconds,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_never_falls_and_ends_at_one() {
        let options = Options {
            rounds: 2,
            ..Options::default()
        };
        let mut plan = Plan::new(&options, 20, 45_000);
        let mut seen = Vec::new();
        let mut sink = |event: &Event| {
            if let Event::Progress { progress, .. } = event {
                seen.push(*progress);
            }
        };
        plan.finish(Stage::Poses, false, &mut sink);
        for _ in 0..2 {
            for stage in [
                Stage::Enhance,
                Stage::Deblur,
                Stage::Reconstruct,
                Stage::Render,
                Stage::Evaluate,
                Stage::Match,
            ] {
                plan.advance(stage, 0.5, &mut sink);
                plan.finish(stage, false, &mut sink);
            }
            // Late views.
            plan.advance(Stage::Poses, 0.5, &mut sink);
            plan.finish(Stage::Poses, false, &mut sink);
        }
        assert!(seen.windows(2).all(|pair| pair[0] <= pair[1]), "{seen:?}");
        assert!((seen.last().expect("some") - 1.0).abs() < 1e-9);
    }

    #[test]
    fn one_round_with_the_steps_of_two_trains_as_long() {
        let options = Options::default();
        let two = Plan::new(&options, 20, 45_000);
        let mut one = two.clone();
        one.set_rounds(1);
        one.multiply_steps(2.0);
        let training = |plan: &Plan| f64::from(plan.rounds) * plan.weight(Stage::Reconstruct);
        assert!((training(&one) - training(&two)).abs() < 1e-9);
        assert!(one.total() < two.total());
    }
}
