//! Golden runs: the results of a fixed capture, seed and poses, byte for byte.
//!
//! Changes of structure must not change a result. `tests/golden/runs.json` holds, for each known
//! machine, the hashes of `scene.ply` and `cameras.json` and all of `metrics.json` except its
//! times. The bytes depend only on the adapter and the processor (the C library and ONNX Runtime
//! choose their code by it); on an unknown machine, the scores must still agree with those of the
//! known ones.
//!
//! The file also holds the `CODE_VERSION` of the build that made the values. `FLED_BLESS=1` adds an
//! unknown machine. It replaces the values of a known one only under a new `CODE_VERSION`, since
//! results kept by an earlier build would otherwise stand beside changed ones. Bless only a build
//! known to be good, and in a separate commit.

use std::fs;
use std::path::{Path, PathBuf};

use fled_core::pipeline::workspace::CODE_VERSION;
use fled_core::synthetic::{SynthOptions, generate};
use serde::{Deserialize, Serialize};
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

/// The golden file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Golden {
    /// [`CODE_VERSION`] of the build that made the values.
    code_version: u32,
    /// The outcomes of all runs, by machine.
    #[serde(flatten)]
    machines: Map<String, Value>,
}

impl Golden {
    fn read() -> Self {
        serde_json::from_value(json(&golden_file())).expect("a version and machines")
    }

    /// The differences of these outcomes from the known ones.
    fn changes(&self, found: &Map<String, Value>) -> Vec<String> {
        found.iter().flat_map(|(run, found)| faults(&self.machines, run, found)).collect()
    }

    /// The faults of a build with this [`CODE_VERSION`] and these outcomes.
    fn faults(&self, found: &Map<String, Value>, version: u32) -> Vec<String> {
        let mut faults = self.changes(found);
        if version != self.code_version {
            faults.push(format!(
                "the golden values are of CODE_VERSION {}, and this build has {version}: run once \
                 with FLED_BLESS=1",
                self.code_version
            ));
        }
        faults
    }

    /// With the outcomes of this machine. The values of other machines stay only while those of
    /// this one do.
    ///
    /// # Errors
    /// The differences from the known outcomes, unless this build has a newer [`CODE_VERSION`].
    fn bless(mut self, found: Map<String, Value>, version: u32) -> Result<Self, String> {
        let changes = self.changes(&found);
        if version < self.code_version {
            return Err(format!(
                "the golden values are of CODE_VERSION {}, and this build has {version}",
                self.code_version
            ));
        }
        if version == self.code_version && !changes.is_empty() {
            return Err(format!(
                "results have changed, but CODE_VERSION is still {version}, so reruns and resumed \
                 jobs would mix them with those of earlier builds: raise CODE_VERSION in \
                 src/core/pipeline/workspace.rs, then bless again\n{}",
                changes.join("\n")
            ));
        }
        if !changes.is_empty() {
            self.machines.clear();
        }
        let machine = machine(found.values().next().expect("a run"));
        self.machines.insert(machine, Value::Object(found));
        Ok(Self { code_version: version, ..self })
    }
}

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

    let run = |(run, options): (&str, &[&str])| {
        (run.to_owned(), outcome(&capture, &folder.path().join(run), options))
    };
    let found: Map<String, Value> = RUNS.into_iter().map(run).collect();
    let golden = Golden::read();
    assert!(!golden.machines.is_empty(), "no machine is known");
    if std::env::var_os("FLED_BLESS").is_some() {
        let blessed = golden.bless(found, CODE_VERSION).unwrap_or_else(|why| panic!("{why}"));
        let text = serde_json::to_string_pretty(&blessed).expect("JSON") + "\n";
        fs::write(golden_file(), text).expect("written");
        return;
    }
    let wrong = golden.faults(&found, CODE_VERSION);
    assert!(wrong.is_empty(), "results have changed:\n{}", wrong.join("\n"));
}

/// The outcomes of the first known machine, and the same with one score moved.
fn same_and_changed(golden: &Golden) -> (Map<String, Value>, Map<String, Value>) {
    let (_, runs) = golden.machines.iter().next().expect("a machine");
    let mut changed = runs.clone();
    let score = &mut changed["kernels"]["metrics.json"]["rounds"][0]["records"][0]["psnr_db"];
    *score = json!(score.as_f64().expect("dB") + 1.0);
    let outcomes = |runs: &Value| runs.as_object().expect("runs").clone();
    (outcomes(runs), outcomes(&changed))
}

#[test]
fn a_changed_result_is_detected_on_any_machine() {
    let golden = Golden::read();
    let (same, changed) = same_and_changed(&golden);
    let known_as = |name: &str| {
        let machines = Map::from_iter([(name.to_owned(), Value::Object(same.clone()))]);
        Golden { code_version: 5, machines }
    };
    let here = known_as(&machine(&same["kernels"]));
    assert_eq!(known_as("elsewhere").faults(&changed, 5).len(), 1);
    assert_eq!(here.faults(&changed, 5).len(), 1);
    assert!(here.faults(&same, 5).is_empty());
    assert_eq!(here.faults(&same, 6).len(), 1, "the values are of another version");
}

#[test]
fn changed_results_are_blessed_only_under_a_new_code_version() {
    let (same, changed) = same_and_changed(&Golden::read());
    let name = machine(&same["kernels"]);
    let runs = Value::Object(same.clone());
    let here = Map::from_iter([(name.clone(), runs.clone())]);
    let elsewhere = Map::from_iter([("elsewhere".to_owned(), runs.clone())]);
    let both = here.clone().into_iter().chain(elsewhere.clone()).collect();
    let known =
        |machines: &Map<String, Value>| Golden { code_version: 5, machines: machines.clone() };

    let refused = known(&both).bless(changed.clone(), 5).expect_err("the version was not raised");
    assert!(refused.contains("raise CODE_VERSION"), "{refused}");
    known(&both).bless(same.clone(), 4).expect_err("an old build");
    known(&elsewhere).bless(changed.clone(), 5).expect_err("unlike the scores of other machines");
    assert_eq!(known(&elsewhere).bless(same.clone(), 5), Ok(known(&both)), "a new machine");
    let raised = known(&both).bless(changed.clone(), 6).expect("the version was raised");
    assert_eq!(raised.machines, Map::from_iter([(name, Value::Object(changed))]));
    let unchanged = known(&both).bless(same, 6).expect("nothing has changed");
    assert_eq!(unchanged, Golden { code_version: 6, machines: both });
}
