//! Tests of videos and exports of a finished run.

use std::path::Path;
use std::process::{Command, Output};

use fled_core::gaussians::ply;
use fled_core::poses::model::SparseModel;
use serde_json::json;

use crate::support::{code, fled, json, said, small_capture, small_run, succeed};

fn made(arguments: &[&str], run: &Path, out: &Path) -> Output {
    let mut command = fled();
    command.arg(arguments[0]).arg(run).args(&arguments[1..]);
    command.arg("--output").arg(out).output().expect("it starts")
}

/// Codec, width, height, pixel format, number of frames.
fn probed(video: &Path) -> String {
    let entries = "stream=codec_name,width,height,pix_fmt,nb_read_frames";
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-count_frames", "-of", "csv=p=0"])
        .args(["-show_entries", entries])
        .arg(video)
        .output()
        .expect("ffmpeg, which `make setup` installs");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

#[test]
fn a_finished_run_becomes_videos_and_exports() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = folder.path().join("out");
    succeed(&mut small_run(&small_capture(folder.path()), &run, 1));
    let video = folder.path().join("a.mp4");
    let plan = folder.path().join("plan.json");
    let cameras = json(&run.join("cameras.json"));
    let pose = |i: usize, seconds: f64| json!({ "world_to_camera": cameras[i]["world_to_camera"], "seconds": seconds });
    let path = json!({ "kind": "path", "fps": 10, "poses": [pose(0, 0.0), pose(9, 1.5)] });
    std::fs::write(&plan, path.to_string()).expect("written");
    let plan = plan.display().to_string();
    for (way, expected) in [
        (&["video", "--orbit", "--seconds", "1", "--degrees", "30"][..], "h264,128,80,yuv420p,24"),
        (
            &["video", "--cameras", "--seconds", "1", "--fps", "5", "--size", "96x96", "--json"],
            "h264,96,96,yuv420p,5",
        ),
        (&["video", "--plan", &plan], "h264,128,80,yuv420p,15"),
    ] {
        let output = made(way, &run, &video);
        assert_eq!(code(&output), 0, "{way:?}: {}", said(&output));
        assert_eq!(probed(&video), expected, "{way:?}");
        let lines = String::from_utf8_lossy(&output.stdout).into_owned();
        let last = lines.lines().last().unwrap_or_default();
        let is_known = last.starts_with(r#"{"event":"finished","best_round":0,"#);
        assert_eq!(is_known, way.contains(&"--json"), "{lines}");
    }
    let model = folder.path().join("colmap.zip");
    let output = made(&["export", "colmap.zip"], &run, &model);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let unpacked = folder.path().join("colmap");
    let unzip = ["-m", "zipfile", "-e"];
    let mut python = Command::new("python3");
    succeed(python.args(unzip).arg(&model).arg(&unpacked));
    let read = SparseModel::read(&unpacked.join("sparse/0")).expect("a model");
    assert_eq!(Some(read.images.len()), cameras.as_array().map(Vec::len));
    assert!(read.points.len() > 100, "{} points", read.points.len());
    let small = folder.path().join("small.ply");
    let output = made(&["export", "scene.compressed.ply", "--round", "1"], &run, &small);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let size = |path: &Path| path.metadata().expect("there").len();
    assert!(4 * size(&small) < size(&run.join("scene.ply")) + 4000);
    the_scene_is_trimmed(folder.path(), &run);
    the_scene_becomes_a_mesh(folder.path(), &run);
}

/// It has the wanted size, and the command tells its measures.
fn the_scene_becomes_a_mesh(folder: &Path, run: &Path) {
    let mesh = folder.join("mesh.ply");
    let export = ["export", "mesh.ply", "--triangles", "2000"];
    let output = made(&export, run, &mesh);
    assert_eq!(code(&output), 0, "{}", said(&output));
    assert!(said(&output).contains("% of the views' pixels"), "{}", said(&output));
    let bytes = std::fs::read(&mesh).expect("there");
    let header = String::from_utf8_lossy(&bytes[..600]).into_owned();
    let count = header.lines().find_map(|line| line.strip_prefix("element face "));
    let count: usize = count.and_then(|count| count.parse().ok()).expect("a count");
    assert!((1..=2000).contains(&count), "{header}");
    let output = made(&["export", "mesh.ply", "--voxel", "1e-9"], run, &mesh);
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("is too fine"), "{}", said(&output));
}

/// Its harmonics are padded, and it is cropped.
fn the_scene_is_trimmed(folder: &Path, run: &Path) {
    let padded = folder.join("padded.ply");
    let output = made(&["export", "scene.ply", "--sh-degree", "3"], run, &padded);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let gaussians = ply::read_extent(&run.join("scene.ply")).expect("a scene").gaussians;
    let bytes = std::fs::read(&padded).expect("there");
    let end = b"end_header\n";
    let header = bytes.windows(end.len()).position(|words| words == end).expect("a header");
    assert_eq!(bytes.len(), header + end.len() + 248 * gaussians);
    let kept = |shape: &str| {
        let output = made(&["export", "scene.ply", "--crop", shape], run, &padded);
        assert_eq!(code(&output), 0, "{}", said(&output));
        ply::read_extent(&padded).expect("a scene").gaussians
    };
    let [some, all] = ["sphere:0,0,0,2", "box:0,0,0,1e9,1e9,1e9"].map(kept);
    assert!(0 < some && some < all && all == gaussians, "{some} of {gaussians}");
    for (arguments, exit, fault) in [
        (
            &["export", "scene.ply", "--crop", "sphere:1e6,0,0,1"][..],
            3,
            "the middle of the scene is",
        ),
        (&["video", "--orbit", "--crop", "sphere:1e6,0,0,1"], 3, "the middle of the scene is"),
        (&["export", "restored.zip", "--sh-degree", "1"], 2, "restored.zip holds no scene"),
        (&["export", "linear.zip", "--round", "1"], 2, "of the delivered round alone"),
    ] {
        let output = made(arguments, run, &padded);
        assert_eq!(code(&output), exit, "{}", said(&output));
        assert!(said(&output).contains(fault), "{}", said(&output));
    }
    let output = made(&["export", "scene.ply"], run, &run.join("scene.ply"));
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("a file of the run itself"), "{}", said(&output));
}

#[test]
fn impossible_videos_and_exports_explain_why() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let out = folder.path().join("a.mp4");
    let nothing = folder.path().join("nothing");
    let output = made(&["video", "--orbit"], &nothing, &out);
    assert_eq!(code(&output), 1, "{}", said(&output));
    assert!(said(&output).contains("cameras.json"), "{}", said(&output));
    let output = made(&["export", "restored.zip"], &nothing, &out);
    assert_eq!(code(&output), 3, "{}", said(&output));
    assert!(said(&output).contains("a finished `fled run`"), "{}", said(&output));
    for wrong in [
        &["video"][..],
        &["video", "--orbit", "--cameras"],
        &["video", "--cameras", "--degrees", "9"],
        &["export", "scene.obj"],
        &["export", "scene.ply", "--crop", "ball:0,0,0,1"],
        &["export", "scene.ply", "--crop", "sphere:0,0,0,-1"],
        &["export", "scene.ply", "--sh-degree", "4"],
        &["export", "mesh.ply", "--triangles", "99"],
        &["export", "mesh.ply", "--voxel", "0"],
    ] {
        let output = made(wrong, &nothing, &out);
        assert_eq!(code(&output), 2, "{wrong:?}: {}", said(&output));
    }
    assert!(!out.exists());
}
