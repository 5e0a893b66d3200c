use serde_json::json;

use super::*;
use crate::pipeline::config::{Setting, ShakeModel, TrainOn};

/// The results that each option invalidates, in the order of Algorithm 1. Options without any act
/// through the tools that they choose.
const STALE: [(&str, &[&str]); 29] = [
    ("detail", &["views", "enhance", "deblur", "reconstruct", "guided"]),
    ("minutes", &["reconstruct", "guided"]),
    ("rounds", &["enhance", "deblur", "reconstruct", "guided"]),
    ("steps", &["reconstruct", "guided"]),
    ("size", &["views", "enhance", "deblur", "reconstruct", "guided"]),
    ("exposure", &["views", "enhance", "deblur", "reconstruct", "guided"]),
    ("target", &["enhance", "deblur", "reconstruct", "guided"]),
    ("lut_scope", &["enhance", "deblur", "reconstruct", "guided"]),
    ("deblur", &[]),
    ("enhance", &[]),
    ("guide", &["guided"]),
    ("noise", &["reconstruct", "guided"]),
    ("shake", &["reconstruct", "guided"]),
    ("train_on", &["reconstruct", "guided"]),
    ("loss", &["reconstruct", "guided"]),
    ("refine_poses", &["reconstruct", "guided"]),
    ("late_views", &[]),
    ("start", &["reconstruct", "guided"]),
    ("schedule", &["reconstruct", "guided"]),
    ("densify", &["reconstruct", "guided"]),
    ("cap", &["reconstruct", "guided"]),
    ("sh_degree", &["reconstruct", "guided"]),
    ("background", &["reconstruct", "guided"]),
    ("held_out", &["reconstruct", "guided"]),
    ("pose_source", &["poses"]),
    ("key_points", &[]),
    ("deliver", &[]),
    ("seed", &["poses", "enhance", "deblur", "reconstruct", "guided"]),
    ("adapter", &[]),
];

/// Another valid value of every option.
fn other(option: &str) -> Value {
    match option {
        "minutes" | "rounds" | "steps" | "size" | "cap" | "seed" => json!(777),
        "detail" => json!("high"),
        "exposure" => json!("as_taken"),
        "sh_degree" => json!(1),
        "target" => json!("10,0.8"),
        "lut_scope" => json!("image"),
        "deblur" | "enhance" => json!("mine"),
        "guide" => json!("none"),
        "noise" => json!("paper"),
        "shake" => json!("off"),
        "schedule" => json!("published"),
        "densify" => json!("classic"),
        "train_on" => json!("enhanced"),
        "loss" => json!("plain"),
        "refine_poses" | "late_views" => json!(false),
        "start" => json!("scratch"),
        "background" => json!("black"),
        "held_out" => json!("5"),
        "pose_source" | "key_points" => json!("colmap"),
        "deliver" => json!("last"),
        "adapter" => json!("other"),
        unknown => panic!("say another value of `{unknown}`, and what it makes stale"),
    }
}

fn network(id: &str) -> RestorerInfo {
    RestorerInfo {
        id: id.to_owned(),
        sha256: String::new(),
        provider: "cpu".to_owned(),
        channels: 6,
        feeding: String::new(),
    }
}

fn networks(deblur: &str, enhance: Option<&str>) -> Networks {
    Networks { deblur: network(deblur), enhance: enhance.map(network) }
}

fn found() -> Poses {
    Poses {
        views: Vec::new(),
        points: Vec::new(),
        registered: 3,
        total: 3,
        source: "made up".to_owned(),
        strategy: None,
        mean_reprojection_error: None,
        mean_track: None,
        verdicts: Vec::new(),
        parts: Vec::new(),
        low_confidence: false,
        network: None,
        seconds: 0.0,
        ..Poses::default()
    }
}

/// The fingerprint of each kind of result.
fn results(options: &Options, networks: &Networks) -> Vec<(&'static str, String)> {
    let poses = PosesDependencies::new(options, "capture", "source", networks);
    let run =
        RunDependencies::new(options, "capture", &found(), networks.clone(), "adapter".to_owned());
    let first = run.round(1, None);
    let second = run.round(2, Some(&first));
    let dependencies = [
        ("poses", poses.first),
        ("poses of deblurred", poses.second),
        ("views", run.views.clone()),
        ("enhance", run.enhance().clone()),
        ("deblur", first.deblur),
        ("reconstruct", first.reconstruct),
        ("guided", second.deblur),
        ("run", run.run()),
    ];
    dependencies.into_iter().map(|(name, on)| (name, on.fingerprint().to_owned())).collect()
}

fn stale(before: &[(&'static str, String)], after: &[(&'static str, String)]) -> Vec<&'static str> {
    let changed = |((name, before), (_, after)): (&(&'static str, String), &(_, String))| {
        (before != after).then_some(*name)
    };
    before.iter().zip(after).filter_map(changed).collect()
}

/// The results of the three long stages, and their inputs.
const LISTED: [&str; 6] = ["poses", "views", "enhance", "deblur", "reconstruct", "guided"];

#[test]
fn an_option_invalidates_only_its_readers_and_what_follows() {
    let options = Options::default();
    let all = networks("one", None);
    let before = results(&options, &all);
    let names = options.names();
    assert_eq!(names.len(), STALE.len(), "an option is missing above");
    for name in &names {
        let mut changed = serde_json::to_value(&options).expect("JSON");
        assert_ne!(changed[name], other(name), "the same value says nothing");
        changed[name] = other(name);
        let changed: Options = serde_json::from_value(changed).expect("valid");
        let stale = stale(&before, &results(&changed, &all));
        assert!(stale.contains(&"run"), "the whole result is another");
        let listed: Vec<&str> = LISTED.into_iter().filter(|stage| stale.contains(stage)).collect();
        let (_, expected) = STALE
            .iter()
            .find(|(option, _)| option == name)
            .unwrap_or_else(|| panic!("say what `{name}` makes stale"));
        assert_eq!(listed, *expected, "stale by `{name}`");
    }
}

#[test]
fn another_network_keeps_poses_and_scenes_of_enhanced_views() {
    let options = Options { shake: ShakeModel::Kernel, ..Options::default() };
    let before = results(&options, &networks("one", None));
    let after = |networks| stale(&before, &results(&options, &networks));
    let all = after(networks("two", None));
    assert_eq!(all, ["poses of deblurred", "deblur", "guided", "run"]);
    let brightened = after(networks("one", Some("two")));
    assert!(brightened.contains(&"enhance") && !brightened.contains(&"views"));
}

#[test]
fn another_network_invalidates_scenes_of_deblurred_views() {
    let deblurred = Options { train_on: TrainOn::Deblurred, ..Options::default() };
    // By default the first round trains on them.
    for options in [deblurred, Options::default()] {
        let before = results(&options, &networks("one", None));
        let after = results(&options, &networks("two", None));
        let stale = stale(&before, &after);
        assert!(stale.contains(&"reconstruct"), "{stale:?}");
        assert!(stale.contains(&"guided"), "guided by that scene: {stale:?}");
    }
}

#[test]
fn a_stage_sees_defaults_for_options_that_it_does_not_name() {
    let options =
        Options { steps: Setting::Given(7), cap: Setting::Given(777), ..Options::default() };
    let depends_on = Dependencies::on(&options, &["steps"], &[]);
    assert_eq!(depends_on.options().steps, Setting::Given(7));
    assert_eq!(depends_on.options().cap, Options::default().cap);
}

#[test]
fn a_round_depends_on_the_one_before_it() {
    let one = networks("one", None);
    let adapter = "adapter".to_owned();
    let run = RunDependencies::new(&Options::default(), "capture", &found(), one, adapter);
    let first = run.round(1, None);
    let second = run.round(2, Some(&first));
    let other = run.round(2, Some(&second));
    assert!(!first.is_guided && second.is_guided);
    for (a, b) in [(&first, &second), (&second, &other)] {
        assert_ne!(a.reconstruct.fingerprint(), b.reconstruct.fingerprint());
        assert_ne!(a.deblur.fingerprint(), b.deblur.fingerprint());
    }
}

#[test]
fn rounds_at_the_target_differ_from_rising_ones() {
    let one = networks("one", None);
    let adapter = "adapter".to_owned();
    let run = RunDependencies::new(&Options::default(), "capture", &found(), one, adapter);
    let rising = run.clone().with_levels(Levels::Rising).round(1, None);
    assert_eq!(rising.deblur.fingerprint(), run.round(1, None).deblur.fingerprint());
    let level = run.with_levels(Levels::Target).round(1, None);
    assert_ne!(level.deblur.fingerprint(), rising.deblur.fingerprint());
    assert_ne!(level.reconstruct.fingerprint(), rising.reconstruct.fingerprint());
}
