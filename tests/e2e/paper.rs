//! The preset `paper` against docs/paper.md, and a run of it.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use fled_core::pipeline::config::Preset;
use serde_json::{Map, Value, json};

use crate::support::{fled, json, small_capture, succeed};

/// The column of docs/paper.md with the preset's options.
const DOES: usize = 3;

/// The options in a page's tables, each once.
fn stated(page: &str) -> BTreeMap<String, String> {
    let mut options = BTreeMap::new();
    for row in page.lines().filter(|line| line.starts_with('|')) {
        let cell = row.split('|').nth(DOES).unwrap_or_default();
        let quoted = cell.split('`').skip(1).step_by(2);
        for (key, value) in quoted.filter_map(|code| code.split_once('=')) {
            let before = options.insert(key.to_owned(), value.to_owned());
            assert_eq!(before, None, "`{key}` stands twice");
        }
    }
    options
}

/// The faults of a page: options that it omits, or that differ from the preset's.
fn faults(page: &str) -> Vec<String> {
    let (preset, stated) = (Preset::Paper.options(), stated(page));
    let all = json!(preset);
    let keys = all.as_object().expect("options are an object").keys();
    let missing = keys.filter(|key| !stated.contains_key(*key));
    let mut faults: Vec<String> = missing.map(|key| format!("{key} is missing")).collect();
    for (key, value) in &stated {
        match preset.with_assignment(&format!("{key}={value}")) {
            Ok(options) if options == preset => {}
            Ok(_) => faults.push(format!("{key} is {}, not {value}", all[key])),
            Err(error) => faults.push(error.to_string()),
        }
    }
    faults
}

fn page() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/paper.md");
    fs::read_to_string(path).expect("docs/paper.md")
}

#[test]
fn the_page_states_every_option_of_the_preset() {
    assert_eq!(faults(&page()), [""; 0]);
}

#[test]
fn a_page_that_states_another_value_is_found() {
    let wrong = page().replacen("guide=raw", "guide=render", 1).replacen("`seed=0`", "seed", 1);
    assert_eq!(faults(&wrong), ["seed is missing", "guide is \"raw\", not render"]);
}

#[test]
fn the_preset_runs_as_the_page_states() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(home.path());
    let out = home.path().join("out");
    let overrides = [("size", 64), ("steps", 110), ("cap", 1_000)];
    let mut run = fled();
    // Only the preset's own choice may leave out the networks for key points.
    run.env("PATH", "/nowhere").env("FLED_MATCHER", "/nowhere");
    run.arg("run").arg(&capture).arg("--out").arg(&out);
    run.args(["--preset", "paper", "--cache", "none"]);
    for (key, value) in overrides {
        run.args(["--set", &format!("{key}={value}")]);
    }
    succeed(&mut run);
    let report = json(&out.join("metrics.json"));
    let overrides: Map<String, Value> =
        overrides.iter().map(|(key, value)| ((*key).to_owned(), json!(value))).collect();
    let options = Preset::Paper.options().with_overrides(&overrides).expect("valid");
    assert_eq!(report["config"], json!(options));
    assert_eq!(report["in_effect"], Value::Null, "nothing else decides: {report:#}");
    assert_eq!(report["fallbacks"], json!([]), "{report:#}");
    let rounds = report["rounds"].as_array().expect("rounds");
    assert_eq!((rounds.len(), &report["best_round"]), (2, &json!(2)));
    for round in rounds {
        assert!(round["score"].is_number() && round["noise_map"].is_object(), "{round:#}");
        assert_eq!((&round["steps"], &round["kernels"]), (&json!(110), &json!(0)), "{round:#}");
        assert!(round["anchor"]["alpha"].is_number(), "a curve of the paper: {round:#}");
    }
    assert_eq!(rounds[0]["matched"].as_array().map(Vec::len), Some(12), "a curve for each view");
    let scene = |path: &str| fs::read(out.join(path)).expect("a scene");
    assert_eq!(scene("scene.ply"), scene("rounds/2/scene.ply"));
    assert!(out.join("rounds/1/scene.ply").exists(), "all rounds are kept");
}
