//! Tests of the live events of a run in training.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{json, small_capture, small_run, succeed};

/// The events with these names from a run of one round, in order.
fn events_of(capture: &Path, out: &Path, options: &[&str], names: &[&str]) -> Vec<Value> {
    let mut run = small_run(capture, out, 1);
    for set in ["steps=120"].iter().chain(options) {
        run.args(["--set", set]);
    }
    let output = succeed(run.arg("--json"));
    let lines = String::from_utf8(output.stdout).expect("UTF-8");
    lines
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|event| names.iter().any(|name| event["event"] == *name))
        .collect()
}

#[test]
fn training_reports_scores_and_a_picture_of_held_out_views() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    let events = events_of(&capture, &out, &[], &["held_out_seen", "view_seen"]);
    let (scores, pictures): (Vec<_>, Vec<_>) =
        events.iter().partition(|event| event["event"] == "held_out_seen");
    let steps: Vec<_> = scores.iter().map(|event| event["step"].as_u64()).collect();
    assert_eq!(steps, [Some(100), Some(120)]);
    for event in &scores {
        assert_eq!(
            (&event["round"], &event["steps"], &event["views"], &event["truth"]),
            (&1.into(), &120.into(), &2.into(), &true.into()),
            "{event}"
        );
    }
    // The last step's score is close to the round's score, whose pictures are twice as large.
    let report = json(&out.join("metrics.json"));
    let records = report["rounds"][0]["records"].as_array().expect("records");
    let is_asked = |record: &&Value| {
        record["split"] == "held_out" && record["image"] == "render" && record["reference"] == "gt"
    };
    let record = records.iter().find(is_asked).expect("a record");
    let number = |value: &Value, key: &str| value[key].as_f64().expect(key);
    let (live, round) = (number(scores[1], "psnr_cc_db"), number(record, "psnr_cc_db"));
    assert!(live > round - 1.0 && live < round + 4.0, "{live:.2} dB, {round:.2}");
    assert!(number(scores[1], "ssim") > 0.3, "{}", scores[1]);
    let first = pictures.first().expect("a picture");
    assert_eq!((&first["held_out"], &first["round"]), (&true.into(), &1.into()));
    assert_eq!(first["view"], first_held_out(&out));
    assert!(!out.join("work/training.jpg").exists(), "none trains any more");
}

/// The name of the first held-out view.
fn first_held_out(out: &Path) -> Value {
    let cameras = json(&out.join("cameras.json"));
    let mut cameras = cameras.as_array().expect("cameras").iter();
    let held_out = cameras.find(|camera| camera["split"] == "held_out");
    held_out.expect("one is held out")["name"].clone()
}

#[test]
fn live_scores_need_held_out_views_but_not_truth() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    fs::remove_dir_all(capture.join("HL")).expect("ground truth");
    let names = ["held_out_seen", "view_seen"];
    let own = events_of(&capture, &folder.path().join("own"), &[], &names);
    let scores: Vec<_> = own.iter().filter(|event| event["event"] == "held_out_seen").collect();
    assert!(!scores.is_empty() && scores.iter().all(|event| event["truth"] == false));
    let all_train = ["held_out=none"];
    let none = events_of(&capture, &folder.path().join("none"), &all_train, &names);
    assert!(!none.is_empty(), "a picture");
    for event in none {
        assert_eq!((&event["event"], &event["held_out"]), (&"view_seen".into(), &false.into()));
    }
}
