//! Captures that `fled prepare` made.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{fled, small_capture, small_run};

fn succeed(command: &mut Command) {
    let output = command.output().expect("the binary starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The poses of a run's views; COLMAP triangulates other points each time.
fn poses(out: &Path) -> Value {
    assert!(out.join("scene.ply").exists());
    let poses = fs::read(out.join("poses.json")).expect("poses");
    let poses: Value = serde_json::from_slice(&poses).expect("JSON");
    poses["views"].clone()
}

#[test]
fn a_prepared_and_moved_capture_stands_for_its_photographs() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let (made, moved) = (folder.path().join("made"), folder.path().join("moved"));
    succeed(fled().arg("prepare").arg(&capture).arg("--out").arg(&made));
    fs::rename(&made, &moved).expect("moved");
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    succeed(&mut small_run(&capture, &first, 1));
    fs::rename(&capture, folder.path().join("elsewhere")).expect("moved");
    succeed(&mut small_run(&moved, &second, 1));
    assert_eq!(poses(&first), poses(&second));
    assert_eq!(poses(&first).as_array().map(Vec::len), Some(12));
    let dark = |out: &Path| fs::read(out.join("inputs/000.jpg")).expect("a picture");
    assert!(dark(&first) == dark(&second), "the photographs differ");
    assert!(!first.join("work/prepared").exists(), "prepared images go with the run");
    assert!(moved.join("manifest.json").exists(), "a prepared capture stays");
}

#[test]
fn a_folder_with_other_files_and_a_damaged_capture_are_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    fs::create_dir(&out).expect("made");
    fs::write(out.join("diary.txt"), "mine").expect("written");
    let prepare = || {
        let mut command = fled();
        command.arg("prepare").arg(&capture).arg("--out").arg(&out);
        command.output().expect("the binary starts")
    };
    let refused = prepare();
    assert_eq!(refused.status.code(), Some(3));
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(said.contains("diary.txt is not part of a prepared capture"), "{said}");
    fs::remove_file(out.join("diary.txt")).expect("still there");
    assert!(prepare().status.success());
    fs::remove_file(out.join("003.half")).expect("an image");
    let run = small_run(&out, &folder.path().join("run"), 1).output().expect("started");
    assert_eq!(run.status.code(), Some(3));
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(
        said.contains("not a complete capture prepared") && said.contains("fled prepare"),
        "{said}"
    );
}
