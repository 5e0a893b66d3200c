//! Shared helpers: small captures and the binary.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use fled_core::synthetic::{SynthOptions, generate};

/// The binary under test.
const FLED: &str = env!("CARGO_BIN_EXE_fled");

/// A capture of 12 small, shaken views with true poses, made once per test.
pub fn small_capture(folder: &Path) -> PathBuf {
    small_capture_shaken_by(folder, 3.0)
}

/// A small capture with a blur of at most `blur` px.
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

/// The binary, with ONNX Runtime from `make onnxruntime`, independent of the build folder.
pub fn fled() -> Command {
    let library =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.onnxruntime/libonnxruntime.so");
    let mut command = Command::new(FLED);
    // Tests must not use the networks of the user who runs them.
    command.env("ORT_DYLIB_PATH", library).env("FLED_MODELS", "/nowhere/models");
    command
}

/// `fled run` at a size that takes seconds, with all rounds whether or not the capture is shaken.
/// Caches points beside the capture, because COLMAP's answer differs each time.
pub fn small_run(capture: &Path, out: &Path, rounds: u32) -> Command {
    let mut command = fled();
    command.arg("run").arg(capture).arg("--out").arg(out).args(["--preset", "preview"]);
    command.arg("--cache").arg(capture.with_file_name("cache"));
    for set in [
        "size=128",
        "steps=48",
        "cap=1500",
        "pose_source=given",
        "train_on=deblurred",
        &format!("rounds={rounds}"),
    ] {
        command.args(["--set", set]);
    }
    command
}

/// Runs the command to its end; panics with its output if it fails.
pub fn succeed(command: &mut Command) -> Output {
    let output = command.output().expect("the binary starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Starts a run and kills it, without a chance to clean up, at the first event that contains
/// `moment`.
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

/// Kills a process with SIGKILL; it may have exited already.
pub fn kill(process: u32) {
    let status = Command::new("kill").args(["-9", &process.to_string()]).status();
    status.expect("kill starts");
}

/// Reads a JSON file.
pub fn json(path: &Path) -> serde_json::Value {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&bytes).expect("valid JSON")
}

/// The path of a test network.
pub fn network(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/onnx")
        .join(format!("{name}.onnx"))
}

/// The exit status.
pub fn code(output: &Output) -> i32 {
    output.status.code().expect("not killed")
}

/// The text written to stdout and stderr.
pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}
