//! The time left of recorded runs (tests/golden/time_left.py), and of runs that go evenly.

use std::path::Path;

use serde::Deserialize;
use serde_json::{Map, Value};

use super::*;
use crate::deblur::NetworkChoice;
use crate::event::ProgressSink;
use crate::metrics::CaptureShake;
use crate::pipeline::config::{Preset, Setting};
use crate::pipeline::workspace::{CODE_VERSION, Workspace};

/// Share by which the time left may be wrong, and seconds near the end.
const WRONG_BY: f64 = 0.3;
const WRONG_BY_SECONDS: f64 = 1.0;

/// The recorded run that searches for poses, and one that needs four strategies.
const SEARCHED: usize = 11;
const FOUR_STRATEGIES: usize = 10;

/// The first line of a recording.
#[derive(Deserialize)]
struct Header {
    options: Map<String, Value>,
    views: usize,
    pixels: usize,
}

/// A recorded run.
struct Recording {
    header: Header,
    events: Vec<(f64, Event)>,
}

impl Recording {
    fn read(number: usize) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/time_left");
        let text = std::fs::read_to_string(folder.join(format!("{number}.jsonl"))).expect("read");
        let (header, events) = text.split_once('\n').expect("a line of the run");
        let event = |line| serde_json::from_str(line).expect("seconds and an event");
        Self {
            header: serde_json::from_str(header).expect("a header"),
            events: events.lines().map(event).collect(),
        }
    }

    fn plan(&self, history: History) -> Plan {
        let options = Options::default().with_overrides(&self.header.options);
        let options = options.expect("valid options");
        let by = By {
            adapter: "a".to_owned(),
            network: options.deblur.as_str().to_owned(),
            poses: format!("{:?}", options.pose_source),
        };
        let Header { views, pixels, .. } = self.header;
        let photographs = Photographs { views, pixels, longest: options.longest_side() };
        Plan::new(&options, photographs, by, history)
    }
}

/// A moment of a replayed run.
struct Moment {
    at: f64,
    stage: Stage,
    round: u32,
    progress: f64,
    eta: Option<f64>,
    /// Whether the stage is over.
    is_over: bool,
    /// Whether the number of rounds is still open.
    is_open: bool,
}

/// All moments at which the run tells how far it is.
fn replay(events: &[(f64, Event)], plan: &mut Plan) -> Vec<Moment> {
    let mut moments = Vec::new();
    for (at, event) in events {
        if !plan.take(*at, event) {
            continue;
        }
        let Some(Running { stage, round, last, .. }) = plan.running else {
            continue;
        };
        moments.push(Moment {
            at: *at,
            stage,
            round,
            progress: plan.progress,
            eta: plan.eta,
            is_over: last.0 == 1.0,
            is_open: round == 0 && plan.job.stages().contains(&(0, Stage::Deblur)),
        });
    }
    moments
}

/// The moments whose time left is wrong. As long as the shake may still decide for fewer rounds,
/// only too little is wrong.
fn faults(moments: &[Moment], end: f64) -> Vec<String> {
    let after = moments.iter().skip_while(|moment| moment.stage == Stage::Poses && !moment.is_over);
    let wrong = |moment: &&Moment| {
        let truth = end - moment.at;
        let Some(eta) = moment.eta else { return true };
        let room = (WRONG_BY * truth).max(WRONG_BY_SECONDS);
        eta < truth - room || (eta > truth + room && !moment.is_open)
    };
    let reported = |moment: &Moment| {
        let Moment { at, stage, round, eta, .. } = moment;
        let truth = end - at;
        format!("{at:.1} s, {stage:?} of round {round}: {eta:.1?} s left, not {truth:.1} s")
    };
    after.filter(wrong).map(reported).collect()
}

/// A run's row of docs/results.md: seconds reported / true, after shares of the time since its
/// poses.
fn row(moments: &[Moment], end: f64) -> String {
    let posed = moments.iter().find(|moment| moment.stage != Stage::Poses).expect("a stage").at;
    let cell = |share: f64| {
        let at = posed + share * (end - posed);
        let moment = moments.iter().find(|moment| moment.at >= at).expect("a moment");
        format!("{:.1} / {:.1}", moment.eta.unwrap_or(f64::NAN), end - moment.at)
    };
    format!("| {} |", [0.0, 0.5, 0.9].map(cell).join(" | "))
}

#[test]
fn ten_recorded_runs_tell_a_time_left_that_is_true() {
    let mut history = History::default();
    let mut wrong = Vec::new();
    for number in 0..10 {
        let recording = Recording::read(number);
        let mut plan = recording.plan(history.clone());
        let moments = replay(&recording.events, &mut plan);
        let (end, _) = recording.events.last().expect("an end");
        eprintln!("{}", row(&moments, *end));
        let faults = faults(&moments, *end);
        wrong.extend(faults.into_iter().map(|fault| format!("run {number} at {fault}")));
        assert!(moments.windows(2).all(|pair| pair[0].progress <= pair[1].progress));
        assert_eq!((plan.progress, plan.eta), (1.0, Some(0.0)));
        history = plan.history().clone();
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_time_left_that_is_half_or_missing_is_found() {
    let recording = Recording::read(0);
    let mut plan = recording.plan(History::default());
    let (end, _) = recording.events.last().expect("an end");
    let mut moments = replay(&recording.events, &mut plan);
    assert!(faults(&moments, *end).is_empty());
    moments[40].eta = moments[40].eta.map(|eta| eta / 2.0);
    moments[50].eta = None;
    assert_eq!(faults(&moments, *end).len(), 2);
}

/// Events of one round of training by evenly made steps, `slowness` times as long as expected.
fn even_training(plan: &Plan, slowness: f64) -> Vec<(f64, Event)> {
    let (stage, round, steps) = (Stage::Reconstruct, 1, plan.job.steps(1));
    let mut events = vec![(0.0, Event::StageStarted { stage, round })];
    for done in 1..=steps {
        let work = plan.job.training(round, done);
        let advanced = Event::StageAdvanced {
            stage,
            round,
            done: u64::from(done),
            total: u64::from(steps),
            steps_per_second: None,
        };
        events.push((slowness * plan.seconds(&work), advanced));
    }
    events
}

fn fresh(history: History) -> Plan {
    let options = Options {
        steps: Setting::Given(300),
        deblur: NetworkChoice::Identity,
        ..Options::default()
    };
    let photographs = Photographs { views: 12, pixels: 12 * 240 * 136, longest: 240 };
    Plan::new(&options, photographs, By::default(), history)
}

fn with_poses(history: History) -> Plan {
    let mut plan = fresh(history);
    plan.done.push((0, Stage::Poses));
    plan
}

/// The history of a run whose parts all took `pace` times as long as on two cores.
fn history_of(pace: f64) -> History {
    let parts =
        [Part::Pairs, Part::Mapping, Part::Features, Part::Steps, Part::Kernels, Part::Cameras];
    let cost = |part| Cost { part, by: String::new(), work: 10.0, seconds: 10.0 * pace };
    let mut history = History::default();
    history.add(parts.map(cost).into());
    history
}

#[test]
fn time_left_never_rises_while_steps_go_on_evenly() {
    for slowness in [0.1, 0.5, 0.9, 1.1, 1.5] {
        let mut plan = with_poses(history_of(1.0));
        let moments = replay(&even_training(&plan, slowness), &mut plan);
        let left: Vec<f64> = moments.iter().filter_map(|moment| moment.eta).collect();
        assert_eq!(left.len(), moments.len());
        assert!(left.windows(2).all(|pair| pair[1] <= pair[0]), "{slowness}: {left:.1?}");
    }
}

#[test]
fn a_tenth_of_a_first_training_shows_how_long_it_takes() {
    for slowness in [0.02, 8.0] {
        let mut plan = with_poses(History::default());
        let events = even_training(&plan, slowness);
        let whole = events.last().expect("steps").0;
        let moments = replay(&events, &mut plan);
        let late: Vec<_> = moments.iter().filter(|moment| moment.at > 0.1 * whole).collect();
        let left = |moment: &&Moment| moment.eta.expect("known");
        assert!(late.windows(2).all(|pair| left(&pair[1]) <= left(&pair[0])));
        // The second round goes on as the first, and nothing is known of the other stages.
        let left_of = |(round, stage): (u32, Stage)| match (stage, round) {
            (Stage::Poses, _) | (Stage::Reconstruct, 1) => 0.0,
            (Stage::Reconstruct, _) => slowness * plan.seconds(&plan.job.of(stage, round)),
            _ => plan.seconds(&plan.job.of(stage, round)),
        };
        let after: f64 = plan.job.stages().into_iter().map(left_of).sum();
        let truth = whole - late[0].at + after;
        assert!((left(&late[0]) / truth - 1.0).abs() < 0.3, "{} {truth}", left(&late[0]));
    }
}

fn poses(done: u64, total: u64) -> Event {
    Event::advanced(Stage::Poses, done, total)
}

fn tries(strategy: char) -> Event {
    Event::StrategyStarted { strategy, name: String::new() }
}

/// The time left after the events of a search for poses.
fn reported(history: History, events: &[(f64, Event)]) -> Option<f64> {
    let mut plan = fresh(history);
    plan.take(0.0, &Event::StageStarted { stage: Stage::Poses, round: 0 });
    plan.take(0.0, &tries('L'));
    for (at, event) in events {
        plan.take(*at, event);
    }
    plan.eta
}

/// Photographs within a second, and pairs from there on, each of some seconds.
fn matched(pairs: u64, seconds: f64) -> Vec<(f64, Event)> {
    let counted = (0..=pairs).map(|pair| (1.0 + seconds * pair as f64, poses(12 + pair, 12 + 66)));
    [(0.5, poses(6, 78))].into_iter().chain(counted).collect()
}

#[test]
fn the_search_for_poses_tells_a_time_once_a_run_has_shown_how_long_it_takes() {
    let counted = matched(20, 0.4);
    assert_eq!(reported(History::default(), &counted), None, "no run has shown how long");
    let left = reported(history_of(1.0), &counted).expect("known");
    let twice = reported(history_of(2.0), &matched(20, 0.8)).expect("known");
    assert!((1.9..2.1).contains(&(twice / left)), "{twice} {left}");
}

#[test]
fn from_the_tenth_pair_on_the_pace_of_this_run_decides() {
    let usual = reported(history_of(1.0), &matched(10, 0.4)).expect("known");
    let early = reported(history_of(1.0), &matched(9, 1.2)).expect("known");
    assert!(early < 1.1 * usual, "{early} {usual}: nine pairs say little");
    let slow = reported(history_of(1.0), &matched(10, 1.2)).expect("known");
    assert!((2.5..3.1).contains(&(slow / usual)), "{slow} {usual}");
    // Content that takes a little longer does not slow the machine down.
    let scatter = reported(history_of(1.0), &matched(10, 0.5)).expect("known");
    assert!((0.9..1.2).contains(&(scatter / usual)), "{scatter} {usual}");
    // The pairs of an interrupted search come at once, and say nothing of the pace.
    let mut resumed = vec![(0.5, poses(6, 78)), (1.0, poses(12 + 40, 78))];
    resumed.extend((1..=10).map(|pair| (1.0 + 1.2 * pair as f64, poses(12 + 40 + pair, 78))));
    let resumed = reported(history_of(1.0), &resumed).expect("known");
    let kept = 40.0 * 1.2;
    assert!((resumed + kept - slow).abs() < 0.1 * slow, "{resumed} {slow}");
}

#[test]
fn a_time_left_is_unknown_rather_than_wrong() {
    let mut events = matched(66, 0.4);
    let end = 1.0 + 66.0 * 0.4;
    let at = |events: &[(f64, Event)]| reported(history_of(1.0), events);
    let models = at(&events).expect("models take as long as usual");
    events.push((end + 2.0, tries('A')));
    assert!(at(&events).is_some_and(|left| left < models), "COLMAP's own always have a try");
    let mut late = events.clone();
    late.push((end + 1000.0, poses(1, 3)));
    assert_eq!(at(&late), None, "it takes longer than ever");
    for strategy in ['B', 'G', 'F', 'L', 'A'] {
        events.push((end + 10.0, tries(strategy)));
        assert_eq!(at(&events), None, "{strategy} is a fallback");
    }
    events.push((end + 20.0, Event::StageStarted { stage: Stage::Deblur, round: 0 }));
    assert!(at(&events).is_some());
}

/// A recorded run on a machine that is this many times as slow.
fn slowed(recording: &Recording, by: f64) -> Vec<(f64, Event)> {
    let slowed = |(at, event): &(f64, Event)| {
        let mut event = event.clone();
        if let Event::RoundFinished { metrics } = &mut event {
            metrics.steps_per_second /= by;
            if let Some(between) = &mut metrics.between {
                between.kernels *= by;
                between.cameras *= by;
            }
        }
        (by * at, event)
    };
    recording.events.iter().map(slowed).collect()
}

/// The moments from the tenth pair on at which the time left is off by more than half, or not
/// given: in the search for poses it may be unknown.
fn off_by_half(moments: &[Moment], end: f64) -> Vec<String> {
    let wrong = |moment: &&Moment| {
        let truth = end - moment.at;
        match moment.eta {
            Some(eta) => (eta - truth).abs() > (0.5 * truth).max(WRONG_BY_SECONDS),
            None => (moment.stage, moment.round) != (Stage::Poses, 0),
        }
    };
    let wrong = moments.iter().filter(wrong);
    wrong
        .map(|m| format!("{:.1} s, {:?}: {:?} not {:.1}", m.at, m.stage, m.eta, end - m.at))
        .collect()
}

/// The moments of a replayed recording from its tenth pair on, and its end.
fn from_tenth_pair(events: &[(f64, Event)], plan: &mut Plan) -> (Vec<Moment>, f64) {
    let photographs = plan.job.photographs();
    let is_tenth = |(_, event): &&(f64, Event)| match event {
        Event::StageAdvanced { stage: Stage::Poses, done, .. } => *done >= photographs + 10,
        _ => false,
    };
    let from = events.iter().find(is_tenth).expect("a pair").0;
    let mut moments = replay(events, plan);
    moments.retain(|moment| moment.at >= from);
    (moments, events.last().expect("an end").0)
}

#[test]
fn a_run_at_a_third_of_the_usual_pace_tells_it_from_the_tenth_pair_on() {
    let recording = Recording::read(SEARCHED);
    let mut usual = recording.plan(History::default());
    replay(&recording.events, &mut usual);
    let events = slowed(&recording, 3.0);
    let mut plan = recording.plan(usual.history().clone());
    let (moments, end) = from_tenth_pair(&events, &mut plan);
    let faults = off_by_half(&moments, end);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    let searching = moments.iter().take_while(|moment| moment.stage == Stage::Poses);
    assert!(searching.filter(|moment| moment.eta.is_some()).count() >= 3);
    // A run that has three times as much left as it tells is found.
    let mut plan = recording.plan(usual.history().clone());
    let (moments, end) = from_tenth_pair(&recording.events, &mut plan);
    assert!(off_by_half(&moments, end).is_empty());
    assert!(!off_by_half(&moments, 3.0 * end).is_empty());
}

#[test]
fn a_run_that_needs_four_strategies_leaves_its_time_open_from_the_first_fallback_on() {
    let recording = Recording::read(SEARCHED);
    let mut usual = recording.plan(History::default());
    replay(&recording.events, &mut usual);
    let recording = Recording::read(FOUR_STRATEGIES);
    let is_try = |(_, event): &&(f64, Event)| matches!(event, Event::StrategyStarted { .. });
    let tries: Vec<f64> = recording.events.iter().filter(is_try).map(|(at, _)| *at).collect();
    assert!(tries.len() >= 4, "{tries:?}");
    let mut plan = recording.plan(usual.history().clone());
    let (moments, end) = from_tenth_pair(&recording.events, &mut plan);
    let (usual, fallbacks): (Vec<_>, Vec<_>) =
        moments.into_iter().partition(|moment| moment.at <= tries[2]);
    let searching =
        |moment: &&Moment| (moment.stage, moment.round) == (Stage::Poses, 0) && !moment.is_over;
    let searching: Vec<_> = fallbacks.iter().filter(searching).collect();
    assert!(searching.len() > 2);
    assert!(searching.iter().all(|moment| moment.eta.is_none()), "it cannot be known");
    let faults = off_by_half(&fallbacks, end);
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // Before them it is the time of a run that needs none.
    let too_long = |moment: &Moment| moment.eta.is_some_and(|eta| eta > 1.5 * (end - moment.at));
    assert!(!usual.iter().any(too_long));
}

#[test]
fn progress_goes_forwards_where_a_tool_counts_anew() {
    let mut plan = fresh(History::default());
    let begins = Event::StageStarted { stage: Stage::Poses, round: 0 };
    plan.take(0.0, &begins);
    let mut progress = Vec::new();
    for (at, event) in [
        (1.0, poses(1, 4)),
        (2.0, poses(3, 4)),
        (3.0, poses(1, 6)),
        (4.0, Event::advanced(Stage::Deblur, 6, 6)),
        (5.0, poses(5, 6)),
    ] {
        plan.take(at, &event);
        progress.push(plan.progress);
    }
    assert!(progress[0] < progress[1] && progress[3] < progress[4], "{progress:?}");
    assert_eq!(progress[1..4], [progress[1]; 3]);
    assert!(progress[4] < 0.9, "poses are not all of a run");
}

#[test]
fn a_resumed_training_says_nothing_of_the_pace() {
    let mut plan = fresh(history_of(1.0));
    let (stage, round) = (Stage::Reconstruct, 1);
    plan.take(0.0, &Event::StageStarted { stage, round });
    for (at, done) in [(0.3, 201), (9.0, 290)] {
        let advanced =
            Event::StageAdvanced { stage, round, done, total: 300, steps_per_second: Some(10.0) };
        plan.take(at, &advanced);
    }
    plan.take(10.0, &Event::StageStarted { stage: Stage::Render, round });
    assert!(plan.measured.is_empty(), "{:?}", plan.measured);
}

#[test]
fn a_machine_remembers_its_last_runs_by_what_did_them() {
    let cost =
        |by: &str, seconds| Cost { part: Part::Steps, by: by.to_owned(), work: 1.0, seconds };
    let folder = tempfile::tempdir().expect("temporary folder");
    let workspace = Workspace::open(folder.path()).expect("open");
    let mut history = History::open(Some(folder.path()), &workspace);
    assert_eq!(history.pace(Part::Steps, "cpu"), None);
    for seconds in 1..=30 {
        history.add(vec![cost("cpu", f64::from(seconds))]);
    }
    history.add(vec![cost("gpu", 0.1)]);
    history.write(&workspace).expect("written");
    let history = History::open(Some(folder.path()), &workspace);
    assert_eq!(history.pace(Part::Steps, "cpu"), Some(29.0), "the last three");
    assert_eq!(history.pace(Part::Steps, "gpu"), Some(0.1));
    assert_eq!(history.pace(Part::Render, "cpu"), None);
}

/// The events that a teller passes on of a run which renders and ends, with its costs in `folder`.
fn events_of_a_render(folder: &Path, workspace: &Workspace) -> Vec<Event> {
    let mut reported = Vec::new();
    let mut sink = |event: &Event| reported.push(event.clone());
    let plan = fresh(History::open(Some(folder), workspace));
    let mut teller = ProgressReporter::new(&mut sink, workspace, plan);
    let (stage, round) = (Stage::Render, 1);
    teller.event(&Event::StageStarted { stage, round });
    teller.event(&Event::Finished { best_round: 1, seconds: 1.0 });
    reported
}

#[test]
fn a_finished_run_leaves_its_costs_to_the_next() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let workspace = Workspace::open(folder.path()).expect("open");
    let reported = events_of_a_render(folder.path(), &workspace);
    let [Event::StageStarted { .. }, first, last, Event::Finished { .. }] = &reported[..] else {
        panic!("{reported:?}");
    };
    let done = |event: &Event| matches!(event, Event::Progress { progress: 1.0, .. });
    assert!(!done(first) && done(last), "{reported:?}");
    let history = History::open(Some(folder.path()), &workspace);
    assert!(history.pace(Part::Render, "").is_some());
    let file = folder.path().join("costs.json");
    let mut kept: Value = workspace.read_json(&file).expect("written");
    kept["code_version"] = (CODE_VERSION - 1).into();
    workspace.write_json(&file, &kept).expect("written");
    let history = History::open(Some(folder.path()), &workspace);
    assert_eq!(history.pace(Part::Render, ""), None, "of another version");
    // Below a file there is no room for another.
    let reported = events_of_a_render(&folder.path().join("costs.json"), &workspace);
    assert!(matches!(&reported[3], Event::Warning { code, .. } if code == "costs"), "{reported:?}");
}

#[test]
fn a_shaken_capture_is_less_work_where_its_images_shrink() {
    let work = |preset: Preset, longest, size| {
        let photographs = Photographs { views: 10, pixels: 2_000_000, longest };
        let mut job = Job::new(&preset.options(), photographs);
        // Late views make another plan.
        (0..2).for_each(|_| job.replan(2, 10, Some(CaptureShake::Shaken), Some(size), None));
        job.training(1, 1_000).iter().map(|(_, seconds)| seconds).sum::<f64>()
    };
    // `high` allows 1,600 px, but the photographs have 560.
    for preset in [Preset::Standard, Preset::High] {
        let share = work(preset, 560, 420) / work(preset, 560, 560);
        assert!((0.5..0.9).contains(&share), "{share}");
    }
}

#[test]
fn the_steps_of_a_round_are_those_that_its_training_reports() {
    let mut begun = with_poses(history_of(1.0));
    begun.take(0.0, &Event::StageStarted { stage: Stage::Reconstruct, round: 1 });
    let eta = |total| {
        let mut plan = begun.clone();
        plan.take(1.0, &Event::advanced(Stage::Reconstruct, 100, total));
        (plan.job.steps(1), plan.eta.expect("known"))
    };
    let ([usual, fewer, more], steps) = ([300, 150, 600].map(|total| eta(total).1), eta(150).0);
    assert_eq!(steps, 150);
    assert!(fewer < usual && usual < more, "{fewer} {usual} {more}");
}

#[test]
fn a_plan_with_other_steps_needs_no_verdict_on_shake() {
    let photographs = Photographs { views: 10, pixels: 2_000_000, longest: 560 };
    let mut job = Job::new(&Preset::Standard.options(), photographs);
    job.replan(2, 10, None, None, Some(70));
    assert_eq!((job.steps(1), job.steps(2)), (70, 70));
    job.train(1, 90);
    assert_eq!((job.steps(1), job.steps(2)), (90, 70));
}
