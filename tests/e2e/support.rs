//! Small captures and the binary.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use fled_core::synthetic::{SynthOptions, generate};

/// The binary under test.
const FLED: &str = env!("CARGO_BIN_EXE_fled");

/// A capture of 12 small, shaken views with true poses, made once a test.
pub fn small_capture(folder: &Path) -> PathBuf {
    small_capture_shaken_by(folder, 3.0)
}

/// The same, shaken by at most so many px.
pub fn small_capture_shaken_by(folder: &Path, blur: f64) -> PathBuf {
    let capture = folder.join("capture");
    let options = SynthOptions {
        views: 12,
        width: 128,
        height: 80,
        seed: 3,
        blur,
        ..SynthOptions::default()
    };
    generate(&options, &capture).expect("a synthetic capture");
    capture
}

/// The binary, which finds ONNX Runtime where `make onnxruntime` puts it, wherever the build folder
/// is.
pub fn fled() -> Command {
    let library =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.onnxruntime/libonnxruntime.so");
    let mut command = Command::new(FLED);
    // The networks of whoever runs the tests are none of theirs.
    command
        .env("ORT_DYLIB_PATH", library)
        .env("FLED_MODELS", "/nowhere/models");
    command
}

/// `fled run` at a size that takes seconds. Every round is made, shaken or not. Points are kept
/// beside the capture: COLMAP draws others each time.
pub fn small_run(capture: &Path, out: &Path, rounds: u32) -> Command {
    let mut command = fled();
    command
        .arg("run")
        .arg(capture)
        .arg("--out")
        .arg(out)
        .args(["--preset", "preview"]);
    command.arg("--cache").arg(capture.with_file_name("cache"));
    for set in [
        "size=128",
        "steps=120",
        "cap=1500",
        "pose_source=given",
        "train_on=deblurred",
        &format!("rounds={rounds}"),
    ] {
        command.args(["--set", set]);
    }
    command
}

/// Runs to the end and fails the test with the program's own words when it fails.
pub fn succeed(command: &mut Command) -> Output {
    let output = command.output().expect("the binary starts");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

/// Starts a run and kills it, without a chance to clean up, at the first event that holds `moment`.
pub fn kill_at(run: &mut Command, moment: &str) {
    let mut child = run
        .arg("--json")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");
    let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
    let seen = lines.any(|line| line.expect("UTF-8").contains(moment));
    child.kill().expect("kill");
    child.wait().expect("wait");
    assert!(seen, "the run ended before {moment}");
}

/// kill -9; who is gone already is as good as killed.
pub fn kill(process: u32) {
    let status = Command::new("kill")
        .args(["-9", &process.to_string()])
        .status();
    status.expect("kill starts");
}

/// A JSON file.
pub fn json(path: &Path) -> serde_json::Value {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&bytes).expect("valid JSON")
}

/// A network of the golden values.
pub fn network(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/onnx")
        .join(format!("{name}.onnx"))
}

/// The exit status.
pub fn code(output: &Output) -> i32 {
    output.status.code().expect("not killed")
}

/// What was written to either output.
pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}
