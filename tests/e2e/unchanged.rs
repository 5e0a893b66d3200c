//! Golden runs: the results of a fixed capture, seed and poses, byte for byte.
//!
//! Changes of structure must not change a result. `tests/golden/runs.json` holds, for each known
//! machine, the hashes of `scene.ply` and `cameras.json` and all of `metrics.json` except its
//! times. The bytes depend only on the adapter and the processor (the C library and ONNX Runtime
//! choose their code by it); on an unknown machine, the scores must still agree with those of the
//! known ones. `FLED_BLESS=1` adds this machine or replaces its values: only on a build known to be
//! good, and in a separate commit.

use std::fs;
use std::path::{Path, PathBuf};

use fled_core::synthetic::{SynthOptions, generate};
use serde_json::{Map, Value, json};

use crate::support::{fled, json, succeed};

/// Options of each run besides the common ones; together they cover every branch of a round.
const RUNS: [(&str, &[&str]); 2] = [
    ("kernels", &["steps=60", "shake=kernel"]),
    (
        "paper",
        &[
            "steps=16",
            "rounds=3",
            "target=auto-paper",
            "shake=off",
            "lut_scope=image",
            "start=scratch",
            "noise=paper",
            "densify=classic",
            "guide=raw",
        ],
    ),
];

/// Measured values, which may differ between equal runs.
const CLOCK: [&str; 4] = ["seconds", "steps_per_second", "stages", "between"];

/// Tolerance of the scores on another machine, whose rounding differs and is amplified by training.
const TOLERANCE_DB: f64 = 0.75;

fn golden_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/runs.json")
}

/// The result of one run, in the form of the golden file.
fn outcome(capture: &Path, out: &Path, options: &[&str]) -> Value {
    let mut command = fled();
    // Without COLMAP, the points are drawn from the seed; COLMAP's differ each time.
    command.env("PATH", "/nowhere").arg("run").arg(capture).arg("--out").arg(out);
    command.args(["--preset", "preview", "--cache", "none"]);
    for set in ["size=96", "cap=1000", "pose_source=given"].iter().chain(options) {
        command.args(["--set", set]);
    }
    succeed(&mut command);
    let hash = |file: &str| {
        let bytes = fs::read(out.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        blake3::hash(&bytes).to_hex().to_string()
    };
    json!({
        "scene.ply": hash("scene.ply"),
        "cameras.json": hash("cameras.json"),
        "metrics.json": without_clock(json(&out.join("metrics.json"))),
    })
}

fn without_clock(value: Value) -> Value {
    match value {
        Value::Object(fields) => fields
            .into_iter()
            .filter(|(key, _)| !CLOCK.contains(&key.as_str()))
            .map(|(key, value)| (key, without_clock(value)))
            .collect(),
        Value::Array(items) => items.into_iter().map(without_clock).collect(),
        other => other,
    }
}

/// The machine that determines the bytes: adapter and processor.
fn machine(outcome: &Value) -> String {
    let adapter = outcome["metrics.json"]["adapter"].as_str().expect("an adapter");
    let cpu = fs::read_to_string("/proc/cpuinfo").expect("Linux");
    let field = |name: &str| {
        let line =
            cpu.lines().find(|line| line.split(':').next().is_some_and(|key| key.trim() == name));
        line.and_then(|line| line.split(':').nth(1)).unwrap_or("?").trim().to_owned()
    };
    format!("{adapter}; {} {}/{}", field("vendor_id"), field("cpu family"), field("model"))
}

/// The differences between two outcomes of one run, as paths into the JSON.
fn differences(path: &str, expected: &Value, found: &Value, faults: &mut Vec<String>) {
    match (expected, found) {
        (Value::Object(a), Value::Object(b)) => {
            for key in a.keys().chain(b.keys().filter(|key| !a.contains_key(*key))) {
                let of =
                    |fields: &Map<String, Value>| fields.get(key).cloned().unwrap_or(Value::Null);
                differences(&format!("{path}.{key}"), &of(a), &of(b), faults);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (index, (a, b)) in a.iter().zip(b).enumerate() {
                differences(&format!("{path}[{index}]"), a, b, faults);
            }
        }
        (a, b) if a == b => {}
        (a, b) => faults.push(format!("{path}: {a} became {b}")),
    }
}

/// PSNR of every record, in order, dB.
fn scores(outcome: &Value) -> Vec<f64> {
    let rounds = outcome["metrics.json"]["rounds"].as_array().expect("rounds");
    let records = rounds.iter().flat_map(|round| round["records"].as_array().expect("records"));
    records.map(|record| record["psnr_db"].as_f64().expect("dB")).collect()
}

/// The faults of `found`, given the known outcomes of this machine and of others.
fn faults(known: &Map<String, Value>, run: &str, found: &Value) -> Vec<String> {
    let mut faults = Vec::new();
    if let Some(expected) = known.get(&machine(found)).and_then(|runs| runs.get(run)) {
        differences(run, expected, found, &mut faults);
        return faults;
    }
    for (machine, runs) in known {
        let (expected, found) = (scores(&runs[run]), scores(found));
        if expected.len() != found.len() {
            faults.push(format!("{run}: {} scores, {} on {machine}", found.len(), expected.len()));
        }
        for (index, (a, b)) in expected.iter().zip(&found).enumerate() {
            if (a - b).abs() > TOLERANCE_DB {
                faults.push(format!("{run}: score {index} is {b:.2} dB, {a:.2} on {machine}"));
            }
        }
    }
    faults
}

#[test]
fn a_fixed_capture_seed_and_poses_give_the_bytes_they_always_gave() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("capture");
    let options =
        SynthOptions { views: 12, width: 160, height: 96, seed: 3, ..SynthOptions::default() };
    generate(&options, &capture).expect("a synthetic capture");

    let mut known: Map<String, Value> =
        serde_json::from_value(json(&golden_file())).expect("an object of machines");
    let mut wrong = Vec::new();
    for (run, options) in RUNS {
        let found = outcome(&capture, &folder.path().join(run), options);
        if std::env::var_os("FLED_BLESS").is_some() {
            let runs = known.entry(machine(&found)).or_insert_with(|| json!({}));
            runs[run] = found;
        } else {
            wrong.extend(faults(&known, run, &found));
        }
    }
    if std::env::var_os("FLED_BLESS").is_some() {
        let text = serde_json::to_string_pretty(&known).expect("JSON") + "\n";
        fs::write(golden_file(), text).expect("written");
    }
    assert!(!known.is_empty(), "no machine is known: run once with FLED_BLESS=1");
    assert!(wrong.is_empty(), "results have changed:\n{}", wrong.join("\n"));
}

#[test]
fn a_changed_result_is_detected_on_any_machine() {
    let known: Map<String, Value> = serde_json::from_value(json(&golden_file())).expect("machines");
    let (name, runs) = known.iter().next().expect("a machine");
    let mut found = runs["kernels"].clone();
    let score = &mut found["metrics.json"]["rounds"][0]["records"][0]["psnr_db"];
    *score = json!(score.as_f64().expect("dB") + 1.0);
    let elsewhere = Map::from_iter([("elsewhere".to_owned(), runs.clone())]);
    assert_eq!(faults(&elsewhere, "kernels", &found).len(), 1);
    let here = Map::from_iter([(machine(&found), runs.clone())]);
    assert_eq!(faults(&here, "kernels", &found).len(), 1, "on {name}");
    assert!(faults(&here, "kernels", &runs["kernels"]).is_empty());
}
