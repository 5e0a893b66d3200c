//! Tests of a suite: configurations of a capture, judged and compared.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::json;

use crate::support::{code, fled, json, said, small_capture, succeed};

/// A suite of a synthetic capture that is its own truth: its held-out views are the test views.
fn suite(folder: &Path, change: &str) -> PathBuf {
    small_capture(folder);
    let content = json!({
        "question": "Does it matter what is rendered behind the scene?",
        "preset": "preview",
        "set": {
            "size": 128, "steps": 40, "cap": 800, "rounds": 1, "pose_source": "given",
            "deblur": "identity", "shake": "off", "noise": "off", "refine_poses": false
        },
        "captures": [{"name": "room", "materials": {"dark": "capture"}, "truth": "capture"}],
        "configurations": [
            {"name": "random"},
            {"name": "black", "set": {"background": "black"}},
            {"name": "nowhere", "set": {"adapter": "no-such-adapter"}}
        ]
    });
    let file = folder.join("suite.json");
    fs::write(&file, content.to_string().replace("\"set\"", change)).expect("written");
    file
}

fn carried_out(file: &Path, arguments: &[&str]) -> Output {
    let mut command = fled();
    command.args(["eval", "suite"]).arg(file).arg("--out");
    command.arg(file.with_file_name("out")).args(arguments);
    command.output().expect("the binary starts")
}

#[test]
fn a_suite_makes_judges_and_compares_the_missing_runs() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = suite(folder.path(), "\"set\"");
    let as_json = folder.path().join("said.json");
    let as_json_argument = as_json.display().to_string();
    let first = carried_out(&file, &["--json", &as_json_argument]);
    assert_eq!(code(&first), 0, "{}", said(&first));
    let table = String::from_utf8_lossy(&first.stdout);
    assert!(table.contains("| room | black |"), "{}", said(&first));
    assert!(table.contains("- failed: room, nowhere, seed 0: "), "{table}");
    assert!(table.contains("Differences to random"), "{table}");

    let summary = json(&as_json);
    let runs = summary["runs"].as_array().expect("runs");
    assert_eq!(runs.len(), 3);
    for run in &runs[..2] {
        let judged = &run["outcome"]["finished"];
        let views = judged["evaluation"]["views"].as_array().expect("views");
        assert_eq!(views.len(), 2, "{run:#}");
        assert_eq!(judged["steps"], 40);
        let name = judged["run"].as_str().expect("a name");
        let kept = folder.path().join("out/runs").join(name);
        assert!(kept.join("scene.ply").exists() && !kept.join("work").exists());
    }
    let differences = summary["differences"].as_array().expect("differences");
    assert_eq!(differences[0]["captures"][0]["pairs"], 2, "{differences:#?}");

    // Only failed runs are repeated, and printing runs nothing.
    let again = carried_out(&file, &[]);
    let tried = String::from_utf8_lossy(&again.stderr).into_owned();
    assert_eq!(tried.matches("fled run").count(), 1, "{tried}");
    assert!(tried.contains("room, nowhere, seed 0"), "{tried}");
    assert_eq!(again.stdout, first.stdout);
    let finished = carried_out(&file, &["--finished"]);
    assert_eq!((&finished.stdout, &finished.stderr), (&first.stdout, &vec![]));
}

#[test]
fn an_invalid_suite_or_evaluation_is_wrong_usage() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let misspelt = carried_out(&suite(folder.path(), "\"sets\""), &[]);
    assert_eq!(code(&misspelt), 2);
    assert!(said(&misspelt).contains("unknown field `sets`"));
    let alone = |words: &[&str]| fled().arg("eval").args(words).output().expect("starts");
    assert_eq!(code(&alone(&["run"])), 2, "without a truth");
    assert_eq!(code(&alone(&[])), 2);
    let help = succeed(fled().args(["eval", "suite", "--help"]));
    assert!(said(&help).contains("--capture-list"));
}
