//! Tests of the command line's exit codes and messages.

use std::fs;
use std::process::Output;

use crate::support::{self, small_capture, small_run};

fn fled(arguments: &[&str]) -> Output {
    support::fled().args(arguments).output().expect("the binary starts")
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("not killed")
}

#[test]
fn wrong_usage_exits_with_two_and_names_the_option() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let out = folder.path().join("out").display().to_string();
    assert_eq!(code(&fled(&["run"])), 2);
    let unknown = fled(&["run", "nowhere", "--out", &out, "--set", "round=3"]);
    assert_eq!(code(&unknown), 2);
    assert!(String::from_utf8_lossy(&unknown.stderr).contains("`round`"));
}

#[test]
fn an_invalid_capture_exits_with_three_and_advice() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let out = folder.path().join("out").display().to_string();
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).expect("folder");
    for capture in ["/nowhere/at/all", &empty.display().to_string()] {
        let output = fled(&["run", capture, "--out", &out]);
        assert_eq!(code(&output), 3, "{capture}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn every_photograph_that_is_not_used_is_named_with_its_reason() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let out = folder.path().join("out").display().to_string();
    let capture = folder.path().join("capture");
    fs::create_dir(&capture).expect("folder");
    let files: [(&str, &[u8], &str); 5] = [
        ("1.bmp", b"BM", "1.bmp is not used: BMP pictures are not read"),
        ("2.jpg", b"", "2.jpg is not used: the file is empty"),
        ("3.jpg", b"\xff\xd8\xff\xe0", "3.jpg is not used: damaged"),
        ("4.jpg", b"a text", "4.jpg is not used: not a JPEG"),
        ("5.mkv", b"", "5.mkv is not used: Matroska"),
    ];
    for (name, bytes, _) in files {
        fs::write(capture.join(name), bytes).expect("written");
    }
    let output = fled(&["poses", &capture.display().to_string(), "--out", &out]);
    assert_eq!(code(&output), 3);
    let said = String::from_utf8_lossy(&output.stderr);
    for (_, _, words) in files {
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn a_missing_adapter_exits_with_four_and_an_event() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let mut run = small_run(&capture, &folder.path().join("out"), 1);
    let output = run
        .args(["--json", "--set", "adapter=no-such-adapter"])
        .output()
        .expect("the binary starts");
    assert_eq!(code(&output), 4, "{}", String::from_utf8_lossy(&output.stderr));
    let last =
        String::from_utf8_lossy(&output.stdout).lines().last().map(str::to_owned).expect("events");
    let event: serde_json::Value = serde_json::from_str(&last).expect("a JSON line");
    assert_eq!(event["event"], "failed");
    assert_eq!(event["kind"], "environment");
    assert!(event["hint"].as_str().is_some_and(|hint| hint.contains("fled doctor")), "{event}");
}

#[test]
fn retired_options_are_ignored_and_missing_models_are_fatal() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let mut run = small_run(&capture, &folder.path().join("out"), 1);
    let output = run
        .args(["--set", "dropout=0.1", "--set", "deblur=no-such-network"])
        .output()
        .expect("the binary starts");
    assert_eq!(code(&output), 3);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("no longer has the option `dropout`"), "{said}");
    assert!(said.contains("small-u2w16"), "{said}");
}

#[test]
fn the_doctor_finds_all_that_the_tests_need() {
    let output = fled(&["doctor"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(code(&output), 0, "{text}");
    for what in ["adapter", "training", "colmap", "onnxruntime", "models", "disk"] {
        assert!(
            text.lines().any(|line| line.starts_with("ok") && line.contains(what)),
            "{what} in\n{text}"
        );
    }
    let without = fled(&["doctor", "--colmap", "/nowhere/colmap"]);
    assert_eq!(code(&without), 4);
    assert!(String::from_utf8_lossy(&without.stdout).contains("apt-get install colmap"));
}

#[test]
fn a_bench_prints_its_table_and_writes_the_same_cases_as_json() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let json = folder.path().join("bench.json");
    let tiny = ["--sizes", "64x48", "--gaussians", "200", "--steps", "3", "--seconds", "0.01"];
    let out = ["--adapter", "cpu", "--json", &json.display().to_string()];
    let output = fled(&[&["bench"][..], &tiny, &out].concat());
    assert_eq!(code(&output), 0, "{}", String::from_utf8_lossy(&output.stderr));
    let (report, table) = (support::json(&json), String::from_utf8_lossy(&output.stdout));
    let cases = report["cases"].as_array().expect("cases");
    assert_eq!(cases.len(), 4);
    for case in cases {
        let name = case["name"].as_str().expect("a name");
        assert!(table.contains(name), "{name} in\n{table}");
        assert!(case["steps_per_second"].as_f64().is_some_and(|rate| rate > 0.0), "{case}");
    }
    assert!(String::from_utf8_lossy(&output.stderr).contains("[4/4] train 64x48"));
}

#[test]
fn invalid_benchmarks_fail_before_they_measure() {
    assert_eq!(code(&fled(&["bench", "--gaussians", "ten"])), 2);
    assert_eq!(code(&fled(&["bench", "--seconds", "0"])), 2);
    assert_eq!(code(&fled(&["bench", "--steps", "0"])), 2);
    let nowhere = fled(&["bench", "--quick", "--capture", "/nowhere/at/all"]);
    assert_eq!(code(&nowhere), 3);
    assert!(!String::from_utf8_lossy(&nowhere.stderr).contains("[1/"));
}
