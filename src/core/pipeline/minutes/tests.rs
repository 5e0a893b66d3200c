//! Tests of a time limit: what it chooses, and how a round keeps to it.

use super::*;
use crate::metrics::CaptureShake;
use crate::pipeline::config::Preset;
use crate::pipeline::plan::History;

fn auto() -> Options {
    Options { minutes: Setting::Given(10), ..Preset::Auto.options() }
}

fn numbers(options: &Options) -> (u32, u32, u32) {
    (options.longest_side(), options.most_gaussians(), options.steps_per_round())
}

/// A machine that takes a second for each thousand steps.
fn by_steps(options: &Options) -> Expected {
    Expected { seconds: f64::from(options.steps_per_round()) / 1e3, is_known: true }
}

#[test]
fn more_time_gives_larger_images_more_gaussians_and_more_steps() {
    let of = |limit| numbers(&climb(limit, &auto(), 4_000, by_steps).0);
    assert_eq!(of(1.0), numbers(&Preset::Standard.options()));
    assert_eq!(of(1e9), numbers(&Preset::High.options()), "never more");
    assert_eq!(of(0.0), (280, 10_000, 300), "never less than is worth a run");
    let (side, cap, steps) = of(2.0);
    assert!((960..1_040).contains(&side), "{side}");
    assert!((180_000..230_000).contains(&cap), "{cap}");
    assert!((1_950..=2_000).contains(&steps), "{steps}");
}

#[test]
fn numbers_that_were_set_stay_and_the_others_are_chosen() {
    let given = Options { cap: Setting::Given(12_345), ..auto() };
    let chosen = climb(1.0, &given, 4_000, by_steps).0;
    assert_eq!(numbers(&chosen), (560, 12_345, 1_000));
    assert_eq!(chosen.cap, given.cap);
    assert!(chosen.size.is_open(), "strong shake may still make the images smaller");
}

#[test]
fn small_photographs_have_no_more_gaussians_than_their_pixels_bear() {
    let chosen = climb(1e9, &auto(), 560, by_steps).0;
    assert_eq!(chosen.most_gaussians(), 30_000);
    assert_eq!(chosen.steps_per_round(), 3_500);
}

#[test]
fn a_limit_needs_a_number_to_choose() {
    let with = |preset: Preset, minutes| Options { minutes, ..preset.options() };
    let given = Setting::Given(5);
    let refused = check_minutes(&with(Preset::Paper, given)).expect_err("all are set");
    assert_eq!(refused.key, "minutes");
    assert!(refused.message.contains("set one of them to `auto`"), "{refused}");
    assert_eq!(check_minutes(&with(Preset::Paper, Setting::Auto)), Ok(()));
    assert_eq!(check_minutes(&with(Preset::Preview, given)), Ok(()), "it leaves the steps open");
}

#[test]
fn the_steps_fill_the_time_that_is_left() {
    let time = |steps: u32| 0.1 * f64::from(steps) + 3.0;
    assert_eq!(fill(50.0, 300, 3_500, time), (470, 50.0));
    assert_eq!(fill(5.0, 300, 3_500, time), (300, 33.0));
    assert_eq!(fill(1e9, 300, 3_500, time).0, 3_500);
}

/// A round of two, on a machine without a history, with a limit as many times as long as is
/// expected: the steps that it has in the end, where training takes `drift` times as long.
fn paced(room: f64, drift: f64, round: u32) -> u32 {
    let forecast = Forecast::on(vec![[560, 420]; 20], History::default());
    let rounds = Rounds { rounds: 2, views: 20, shake: Some(CaptureShake::Shaken), size: 560 };
    let options = Options { steps: Setting::Fitted(1_000), ..Preset::Standard.options() };
    let rest = forecast.rest(&options, rounds, round);
    let sum = |[steps, other]: [f64; 2]| steps + other;
    let ([begun, _], now) = (rest.training(300), rest.training(400));
    let all = sum(rest.training(1_000)) + sum(rest.after());
    let limit = RoundsLimit {
        forecast: &forecast,
        options: &options,
        rounds,
        limit: room * all,
        fills: true,
    };
    let begun = [begun, rest.training(300)[1]];
    let seconds = drift * (now[0] - begun[0]) + now[1] - begun[1];
    limit.pacing(round, 1_000).steps([300, 400], seconds, drift * now[0] + now[1])
}

#[test]
fn a_round_that_goes_as_expected_keeps_its_steps() {
    for round in [1, 2] {
        let steps = paced(1.0, 1.0, round);
        assert!((990..=1_010).contains(&steps), "{steps} in round {round}");
    }
}

#[test]
fn a_slow_round_gets_fewer_steps_and_a_fast_one_more() {
    let slow = paced(1.0, 1.3, 2);
    assert!((720..850).contains(&slow), "{slow}");
    let fast = paced(1.0, 0.8, 2);
    assert!((1_200..1_340).contains(&fast), "{fast}");
    // The second round helps to make up for what the first one has lost.
    assert!(paced(1.0, 1.3, 1) > slow);
}

#[test]
fn the_steps_so_far_stay_within_what_a_round_bears() {
    assert_eq!(paced(0.1, 1.0, 2), 540, "400 are at most three quarters of a round");
    assert_eq!(paced(9.0, 1.0, 2), 1_290, "400 are more than three tenths");
}

#[test]
fn the_pace_is_measured_once_in_the_middle_of_a_round() {
    let forecast = Forecast::on(vec![[560, 420]; 20], History::default());
    let options = Preset::Standard.options();
    let rounds = Rounds { rounds: 2, views: 20, shake: None, size: 560 };
    let limit =
        RoundsLimit { forecast: &forecast, options: &options, rounds, limit: 60.0, fills: true };
    let found = |steps: &[u32]| {
        let mut pacing = limit.pacing(1, 1_000);
        let look = |&step: &u32| pacing.measured(step, 1_000, 0.5 * f64::from(step));
        steps.iter().map(look).collect::<Vec<_>>()
    };
    let every: Vec<u32> = (0..1_000).step_by(25).collect();
    let measured: Vec<_> = found(&every).into_iter().flatten().collect();
    assert_eq!(measured, [(300, 0.5 * 125.0)], "of 300 to 425 steps");
    assert_eq!(found(&[290, 350, 430, 460]), [None, None, None, Some((350, 55.0))]);
    assert_eq!(found(&[600, 710, 720]), [None; 3], "a resumed round is soon too far");
    let mut pacing = limit.pacing(1, 1_000);
    assert_eq!([300, 450].map(|step| pacing.measured(step, 900, 1.0)), [None; 2], "other steps");
    let mut pacing = RoundsLimit { fills: false, ..limit }.pacing(1, 1_000);
    assert_eq!([300, 450].map(|step| pacing.measured(step, 1_000, 1.0)), [None; 2], "set steps");
}
