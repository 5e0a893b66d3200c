//! A run with a time limit.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::json;

use crate::support::{code, fled, json, said, small_capture, succeed};

fn run(capture: &Path, out: &Path, settings: &[&str]) -> Command {
    let mut run = fled();
    run.arg("run").arg(capture).arg("--out").arg(out).args(["--cache", "none"]);
    for setting in settings {
        run.args(["--set", setting]);
    }
    run
}

#[test]
fn a_limit_decides_the_numbers_that_are_open_and_a_rerun_finds_them() {
    let home = tempfile::tempdir().expect("temporary folder");
    let (capture, out) = (small_capture(home.path()), home.path().join("out"));
    let settings = ["minutes=1", "steps=40", "rounds=1", "pose_source=given", "deblur=identity"];
    succeed(&mut run(&capture, &out, &settings));
    let report = json(&out.join("metrics.json"));
    let expected = report["expected_seconds"].as_f64().expect("a time");
    assert!(expected > 0.0 && expected < 60.0, "{expected}");
    let used = &report["in_effect"];
    assert_eq!(used["cap"], json!(10_000), "as many as its small images bear: {used}");
    assert_eq!(used["steps"], json!(null), "it was set: {used}");
    assert_eq!(report["rounds"][0]["steps"], json!(40));
    let log = fs::read_to_string(out.join("log.txt")).expect("a log");
    for part in ["limit of 1 minute: images of ", " 40 steps a round", "is a guess"] {
        assert!(log.contains(part), "{part}: {log}");
    }
    let again = run(&capture, &out, &settings).output().expect("the binary starts");
    assert!(said(&again).contains("already finished"), "{}", said(&again));
}

#[test]
fn a_round_trains_the_steps_that_the_limit_has_time_for_and_keeps_to_a_kept_decision() {
    let home = tempfile::tempdir().expect("temporary folder");
    let (capture, out) = (small_capture(home.path()), home.path().join("out"));
    let settings = [
        "minutes=1",
        "size=64",
        "cap=300",
        "rounds=1",
        "pose_source=given",
        "deblur=identity",
        "refine_poses=false",
    ];
    succeed(&mut run(&capture, &out, &settings));
    let report = json(&out.join("metrics.json"));
    let steps = report["rounds"][0]["steps"].as_u64().expect("a number");
    assert!((600..=7_000).contains(&steps), "{steps}");
    // An earlier process had time for fewer.
    let kept = out.join("work/minutes.json");
    let mut decision = json(&kept);
    decision["refilled"]["steps"] = json!(20);
    fs::write(&kept, decision.to_string()).expect("written");
    for stamp in ["reconstruct-1", "run"] {
        fs::remove_file(out.join(format!("work/stamps/{stamp}.json"))).expect("a stamp");
    }
    succeed(&mut run(&capture, &out, &settings));
    let report = json(&out.join("metrics.json"));
    assert_eq!(report["in_effect"]["steps"], json!(20));
    let steps = report["rounds"][0]["steps"].as_u64().expect("a number");
    // Its pace may leave time for a few more.
    assert!((20..70).contains(&steps), "{steps}");
}

#[test]
fn a_limit_with_nothing_to_choose_is_refused_before_the_photographs_are_read() {
    let home = tempfile::tempdir().expect("temporary folder");
    let out = home.path().join("out");
    let nowhere = home.path().join("nowhere");
    let mut refused = run(&nowhere, &out, &["minutes=5"]);
    let refused = refused.args(["--preset", "paper"]).output().expect("the binary starts");
    assert_eq!(code(&refused), 2, "{}", said(&refused));
    assert!(said(&refused).contains("set one of them to `auto`"), "{}", said(&refused));
}
