//! The schedule of a round: resolution, degree, rates, densification, and the order of the views.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::config::Pace;
use super::densify::classic::RESET_EVERY;

/// Share of the steps at a quarter of the resolution.
const QUARTER_SHARE: f64 = 0.1;
/// Share of the steps after which training runs at full resolution.
const FULL_FROM: f64 = 0.3;
/// Least side of a reduced image, px: SSIM's window of 11 px would see nothing of smaller ones.
const SMALLEST_SIDE: usize = 32;
/// Steps of the published trainers that these rates come from. A round is much shorter, so its
/// steps are larger; with the published rates, splats hardly leave their points in 1,000 steps.
const PUBLISHED_STEPS: f64 = 30_000.0;
/// Largest factor of the means' rate, so that a round of 1,500 steps moves them as far.
const MOST_MEANS_SPEEDUP: f64 = 20.0;
/// Largest factor of all other rates except that of opacities, which is the square root of
/// [`PUBLISHED_STEPS`] over the steps of the round.
const MOST_SPEEDUP: f64 = 5.0;
/// Rate of the means at the start and the end of a round of [`PUBLISHED_STEPS`], world units per
/// step at extent 1.
const MEANS_RATES: (f64, f64) = (1.6e-4, 1.6e-6);
/// Densification runs between these shares of the round.
const DENSIFY: (f64, f64) = (0.05, 0.8);
/// At the published pace it runs after this step and before this share, which is that of the
/// published round, every [`PUBLISHED_INTERVAL`] steps.
const PUBLISHED_FROM: u32 = 500;
const PUBLISHED_UNTIL: f64 = 0.5;
const PUBLISHED_INTERVAL: u32 = 100;
/// Steps between degrees of the harmonics at the published pace.
const PUBLISHED_DEGREE: u32 = 1_000;
/// Share of the round after which the shake is estimated; a warm round does so from its start.
const SHAKE_FROM: f64 = 0.3;
/// Shares of the rest of the round at which it is estimated: dense while the scene changes fast.
/// 20 estimates are no better than these, and a GPU waits for each of them.
const SHAKE_ESTIMATES: [f64; 8] = [0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8];
/// Corrections of the cameras per round, less those before [`POSES_FROM`].
const POSE_CORRECTIONS: u32 = 5;
/// Share of the round after which cameras are corrected; the second is that of a warm round.
const POSES_FROM: f64 = 0.39;
const WARM_POSES_FROM: f64 = 0.19;
/// Share of the round at which exploration noise stops.
const NOISE_END: f64 = 0.9;

/// The purpose of random numbers. Each has its own stream, so that none repeats the numbers of
/// another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// The order of the views in an epoch.
    ViewOrder = 1,
    /// The copied Gaussians, and the positions of the parts of split ones.
    Densification = 2,
    /// The initial points of a round.
    FirstPoints = 3,
    /// The background colour.
    Background = 5,
}

/// The plan of one round: pure functions of the step, so a resumed round continues as if
/// uninterrupted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// Steps of the round.
    pub steps: u32,
    /// Degree of the harmonics at the end.
    pub sh_degree: u32,
    /// Whether the resolution grows.
    pub resolution: bool,
    /// Whether rates, degrees and densification are adapted to short rounds.
    pub pace: Pace,
    /// Whether the round starts from a trained scene.
    pub warm: bool,
    /// Random seed.
    pub seed: u64,
}

impl Schedule {
    /// Share of the round before `step`, 0..=1.
    pub fn share(&self, step: u32) -> f64 {
        f64::from(step) / f64::from(self.steps.max(1))
    }

    /// Divisor of the images at `step` (0-based): 4, 2 or 1. A warm round already has its coarse
    /// shapes; reduced images would only blur them.
    pub fn divisor(&self, step: u32) -> usize {
        let share = self.share(step);
        match share {
            _ if !self.resolution || self.warm => 1,
            s if s < QUARTER_SHARE => 4,
            s if s < FULL_FROM => 2,
            _ => 1,
        }
    }

    /// Active degree at `step`: one more every tenth of the round, or every 1,000 steps as
    /// published, and all of them in a warm round.
    pub fn degree(&self, step: u32) -> u32 {
        if self.warm {
            return self.sh_degree;
        }
        self.sh_degree.min(match self.pace {
            Pace::Adapted => (self.share(step) * 10.0) as u32,
            Pace::Published => (step + 1) / PUBLISHED_DEGREE,
        })
    }

    /// How many times longer the published rounds are; 1 at their pace.
    fn shortness(&self) -> f64 {
        match self.pace {
            Pace::Adapted => PUBLISHED_STEPS / f64::from(self.steps.max(1)),
            Pace::Published => 1.0,
        }
    }

    /// Factor of the rates of scales, quaternions and colours for the length of the round.
    pub fn speedup(&self) -> f64 {
        self.shortness().sqrt().clamp(1.0, MOST_SPEEDUP)
    }

    /// Rate of the means at `step` for a scene of extent 1: exponential decay over the round.
    pub fn means_rate(&self, step: u32) -> f64 {
        let (start, end) = MEANS_RATES;
        let speedup = self.shortness().clamp(1.0, MOST_MEANS_SPEEDUP);
        speedup * start * (end / start).powf(self.share(step))
    }

    /// Whether the means explore at `step`.
    pub fn explores(&self, step: u32) -> bool {
        self.share(step) < NOISE_END
    }

    /// Steps between densifications: 100 as published, fewer in a short round, which would
    /// otherwise have too few.
    pub fn densify_interval(&self) -> u32 {
        match self.pace {
            Pace::Adapted => (self.steps / 20).clamp(10, PUBLISHED_INTERVAL),
            Pace::Published => PUBLISHED_INTERVAL,
        }
    }

    /// Whether densification runs before `step`.
    ///
    /// The paper does not say: how 3DGS's schedule becomes one of 10,000 steps. The means' rate
    /// falls over the round and densification ends at half of it, as in 3DGS's own of 30,000;
    /// intervals and the start stay.
    pub fn densifies(&self, step: u32) -> bool {
        let share = self.share(step);
        let is_within = match self.pace {
            Pace::Adapted => share >= DENSIFY.0 && share < DENSIFY.1,
            Pace::Published => step > PUBLISHED_FROM && share < PUBLISHED_UNTIL,
        };
        step.is_multiple_of(self.densify_interval()) && is_within
    }

    /// Whether the shake of the views is estimated before `step`: never on the coarse images of a
    /// cold round, whose pixels are as large as the shake.
    pub fn estimates_shake(&self, step: u32) -> bool {
        let from = if self.warm { 0.0 } else { SHAKE_FROM };
        SHAKE_ESTIMATES.iter().any(|share| {
            let moment = (from + share * (1.0 - from)) * f64::from(self.steps);
            moment.round() as u32 == step
        })
    }

    /// Whether the cameras are corrected before `step`: only once the scene has edges to judge them
    /// by.
    pub fn refines_poses(&self, step: u32) -> bool {
        let interval = (self.steps / POSE_CORRECTIONS).max(1);
        let from = if self.warm { WARM_POSES_FROM } else { POSES_FROM };
        step.is_multiple_of(interval) && self.share(step) >= from
    }

    /// Whether no correction of the cameras follows that before `step`.
    pub fn refines_poses_last(&self, step: u32) -> bool {
        (step + 1..self.steps).all(|later| !self.refines_poses(later))
    }

    /// Whether classic densification resets opacities before `step`: never in the last half of the
    /// round.
    pub fn resets_opacities(&self, step: u32) -> bool {
        step > 0 && step.is_multiple_of(RESET_EVERY) && self.share(step) < PUBLISHED_UNTIL
    }

    /// Number of densifications in the round.
    pub fn densifications(&self) -> u32 {
        (0..self.steps)
            .step_by(self.densify_interval() as usize)
            .filter(|&s| self.densifies(s))
            .count() as u32
    }

    /// Index of the view of `step`: every view once per epoch, in an order drawn for that epoch.
    pub fn view(&self, step: u32, views: usize) -> usize {
        let (epoch, place) = (step as usize / views, step as usize % views);
        let mut order: Vec<_> = (0..views).collect();
        order.shuffle(&mut self.generator(Stream::ViewOrder, epoch as u64));
        order[place]
    }

    /// A generator for one purpose and one step or epoch, independent of all others.
    pub fn generator(&self, stream: Stream, moment: u64) -> Pcg64 {
        let purpose = (stream as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = self.seed ^ purpose ^ moment.rotate_left(32);
        Pcg64::seed_from_u64(mixed)
    }
}

/// The size of an image reduced by `divisor`, or by the largest factor of it that leaves a side of
/// 32 px; rounded up.
pub fn reduced_size(width: usize, height: usize, divisor: usize) -> (usize, usize) {
    let side = width.min(height);
    let fitting = (1..=divisor)
        .rev()
        .find(|d| divisor.is_multiple_of(*d) && side / d >= SMALLEST_SIDE)
        .unwrap_or(1);
    (width.div_ceil(fitting), height.div_ceil(fitting))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use rand::RngExt;

    use super::*;

    const PLAN: Schedule = Schedule {
        steps: 1_000,
        sh_degree: 3,
        resolution: true,
        pace: Pace::Adapted,
        warm: false,
        seed: 7,
    };

    #[test]
    fn resolution_and_degree_grow_at_the_stated_shares() {
        let divisors = [0, 99, 100, 299, 300, 999].map(|step| PLAN.divisor(step));
        assert_eq!(divisors, [4, 4, 2, 2, 1, 1]);
        assert_eq!([0, 99, 100, 200, 300, 999].map(|step| PLAN.degree(step)), [0, 0, 1, 2, 3, 3]);
        let warm = Schedule { warm: true, ..PLAN };
        assert_eq!((warm.degree(0), warm.divisor(0)), (3, 1));
        assert_eq!(reduced_size(281, 161, 4), (71, 41));
        assert_eq!(reduced_size(80, 70, 4), (40, 35));
    }

    #[test]
    fn the_rate_of_the_means_falls_a_hundredfold_over_a_round() {
        let long = Schedule { steps: 30_000, ..PLAN };
        assert!((long.means_rate(0) - 1.6e-4).abs() < 1e-12);
        assert!((long.means_rate(30_000) - 1.6e-6).abs() < 1e-12);
    }

    #[test]
    fn short_rounds_take_larger_steps_up_to_a_limit() {
        let of = |steps| Schedule { steps, ..PLAN };
        assert_eq!(
            [of(100_000).speedup(), of(30_000).speedup(), of(7_500).speedup(), of(10).speedup()],
            [1.0, 1.0, 2.0, 5.0]
        );
        assert!((of(3_000).means_rate(0) - 1.6e-3).abs() < 1e-12);
        assert!((of(10).means_rate(0) - 3.2e-3).abs() < 1e-12);
    }

    #[test]
    fn an_epoch_shows_every_view_once_and_epochs_differ() {
        let epoch = |n: u32| (0..9).map(|i| PLAN.view(9 * n + i, 9)).collect::<Vec<_>>();
        let mut sorted = epoch(0);
        sorted.sort_unstable();
        assert_eq!(sorted, (0..9).collect::<Vec<_>>());
        assert_ne!(epoch(0), epoch(1));
        assert_eq!(epoch(4), epoch(4));
    }

    #[test]
    fn streams_and_moments_draw_different_numbers() {
        let streams =
            [Stream::ViewOrder, Stream::Densification, Stream::FirstPoints, Stream::Background];
        let first = |stream, moment| PLAN.generator(stream, moment).random::<u64>();
        let drawn: BTreeSet<u64> = streams
            .into_iter()
            .flat_map(|stream| (0..100).map(move |moment| first(stream, moment)))
            .collect();
        assert_eq!(drawn.len(), 100 * streams.len());
    }

    #[test]
    fn shake_is_estimated_at_full_resolution() {
        let steps = |plan: Schedule| {
            (0..plan.steps).filter(move |&s| plan.estimates_shake(s)).collect::<Vec<_>>()
        };
        assert_eq!(steps(PLAN), [300, 335, 370, 440, 510, 615, 720, 860]);
        assert!(steps(PLAN).iter().all(|&s| PLAN.divisor(s) == 1));
        let warm = |steps| Schedule { warm: true, steps, ..PLAN };
        assert_eq!(steps(warm(1_000)), [0, 50, 100, 200, 300, 450, 600, 800]);
        assert_eq!(steps(warm(10_000)).len(), 8, "its steps are more, its estimates are not");
        assert_eq!(steps(warm(10)), [0, 1, 2, 3, 5, 6, 8]);
    }

    #[test]
    fn cameras_are_corrected_only_in_later_steps() {
        let steps =
            |plan: Schedule| (0..1_000).filter(move |&s| plan.refines_poses(s)).collect::<Vec<_>>();
        assert_eq!(steps(PLAN), [400, 600, 800]);
        assert_eq!(steps(Schedule { warm: true, ..PLAN }), [200, 400, 600, 800]);
        assert!(steps(PLAN).iter().all(|&s| PLAN.divisor(s) == 1));
        assert!(!PLAN.refines_poses_last(600) && PLAN.refines_poses_last(800));
    }

    #[test]
    fn the_published_pace_is_that_of_3dgs() {
        let plan = Schedule { steps: 10_000, pace: Pace::Published, resolution: false, ..PLAN };
        assert_eq!(plan.speedup(), 1.0);
        assert!((plan.means_rate(0) - 1.6e-4).abs() < 1e-12);
        assert!((plan.means_rate(5_000) - 1.6e-5).abs() < 1e-12);
        assert!((plan.means_rate(10_000) - 1.6e-6).abs() < 1e-12);
        let short = Schedule { steps: 100, ..plan };
        assert_eq!((short.speedup(), short.means_rate(0)), (1.0, plan.means_rate(0)));
        let steps = |test: &dyn Fn(u32) -> bool| -> Vec<u32> {
            (0..plan.steps).filter(|&step| test(step)).collect()
        };
        let densified = steps(&|step| plan.densifies(step));
        assert_eq!(densified, (6..50).map(|hundred| 100 * hundred).collect::<Vec<_>>());
        assert_eq!(steps(&|step| plan.resets_opacities(step)), [3_000]);
        assert_eq!([998, 999, 1_999, 2_999, 9_999].map(|s| plan.degree(s)), [0, 1, 2, 3, 3]);
        assert!((0..plan.steps).all(|step| plan.divisor(step) == 1));
    }

    #[test]
    fn densification_stays_in_its_window() {
        assert_eq!(PLAN.densify_interval(), 50);
        assert!(
            !PLAN.densifies(0) && PLAN.densifies(50) && !PLAN.densifies(51) && !PLAN.densifies(800)
        );
        assert_eq!(PLAN.densifications(), 15);
    }
}
