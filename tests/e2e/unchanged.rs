//! Golden runs: the results of a fixed capture, seed and poses, byte for byte.
//!
//! Changes of structure must not change a result. `tests/golden/runs.json` holds the hashes of
//! `scene.ply` and `cameras.json`, and all of `metrics.json` except its times and the name of the
//! processor. They are those of the processor, which gives the same bytes on every x86-64 machine
//! with AVX2.
//!
//! The file also holds the `CODE_VERSION` of the build that made the values. `FLED_BLESS=1`
//! replaces them only under a new `CODE_VERSION`, since results kept by an earlier build would
//! otherwise stand beside changed ones. Bless only a build known to be good, in a separate commit.

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

/// Times, which differ between equal runs, and the processor's name with its number of threads.
const VARYING: [&str; 5] = ["seconds", "steps_per_second", "stages", "between", "adapter"];

/// The golden file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Golden {
    /// [`CODE_VERSION`] of the build that made the values.
    code_version: u32,
    /// The outcomes of all runs, by name.
    #[serde(flatten)]
    runs: Map<String, Value>,
}

impl Golden {
    fn read() -> Self {
        serde_json::from_value(json(&golden_file())).expect("a version and runs")
    }

    /// The differences of these outcomes from the known ones.
    fn changes(&self, found: &Map<String, Value>) -> Vec<String> {
        let mut changes = Vec::new();
        let of = |runs: &Map<String, Value>| Value::Object(runs.clone());
        differences("", &of(&self.runs), &of(found), &mut changes);
        changes
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

    /// With these outcomes.
    ///
    /// # Errors
    /// The differences from the known outcomes, unless this build has a newer [`CODE_VERSION`].
    fn bless(self, found: Map<String, Value>, version: u32) -> Result<Self, String> {
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
        Ok(Self { code_version: version, runs: found })
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
    for set in ["adapter=cpu", "size=96", "cap=1000", "pose_source=given"].iter().chain(options) {
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
        "metrics.json": without_varying(json(&out.join("metrics.json"))),
    })
}

fn without_varying(value: Value) -> Value {
    match value {
        Value::Object(fields) => fields
            .into_iter()
            .filter(|(key, _)| !VARYING.contains(&key.as_str()))
            .map(|(key, value)| (key, without_varying(value)))
            .collect(),
        Value::Array(items) => items.into_iter().map(without_varying).collect(),
        other => other,
    }
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
    assert_eq!(golden.runs.len(), RUNS.len());
    if std::env::var_os("FLED_BLESS").is_some() {
        let blessed = golden.bless(found, CODE_VERSION).unwrap_or_else(|why| panic!("{why}"));
        let text = serde_json::to_string_pretty(&blessed).expect("JSON") + "\n";
        fs::write(golden_file(), text).expect("written");
        return;
    }
    let wrong = golden.faults(&found, CODE_VERSION);
    assert!(wrong.is_empty(), "results have changed:\n{}", wrong.join("\n"));
}

/// The known outcomes with one score moved.
fn changed(golden: &Golden) -> Map<String, Value> {
    let mut changed = golden.runs.clone();
    let score = &mut changed["kernels"]["metrics.json"]["rounds"][0]["records"][0]["psnr_db"];
    *score = json!(score.as_f64().expect("dB") + 1.0);
    changed
}

#[test]
fn a_changed_result_and_another_version_are_detected() {
    let golden = Golden { code_version: 5, ..Golden::read() };
    assert!(golden.faults(&golden.runs, 5).is_empty());
    let faults = golden.faults(&changed(&golden), 5);
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(golden.faults(&golden.runs, 6).len(), 1, "the values are of another version");
    let mut missing = golden.runs.clone();
    missing.remove("paper");
    assert!(!golden.faults(&missing, 5).is_empty());
}

#[test]
fn changed_results_are_blessed_only_under_a_new_code_version() {
    let golden = Golden { code_version: 5, ..Golden::read() };
    let (same, changed) = (golden.runs.clone(), changed(&golden));
    let refused = golden.clone().bless(changed.clone(), 5).expect_err("it was not raised");
    assert!(refused.contains("raise CODE_VERSION"), "{refused}");
    golden.clone().bless(same.clone(), 4).expect_err("an old build");
    assert_eq!(golden.clone().bless(same, 5), Ok(golden.clone()));
    let raised = golden.bless(changed.clone(), 6);
    assert_eq!(raised, Ok(Golden { code_version: 6, runs: changed }));
}
