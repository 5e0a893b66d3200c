//! Tests of views that join or leave the scene after its first round.

use std::path::Path;

use fled_core::camera::Camera;
use fled_core::exposure::Gains;
use fled_core::image::Image;
use fled_core::synthetic::{SynthOptions, generate};
use glam::{DMat4, DQuat, DVec3};
use serde_json::{Value, json};

use crate::support::{fled, json, succeed};

/// The photograph without a pose, and the one rotated by 12 degrees.
const LOST: &str = "004";
const MOVED: &str = "007";
/// Exposures of the photographs by their number modulo 4, stops; that of 004 is the first.
const STOPS: [f64; 4] = [0.6, -0.2, 0.0, -0.4];

fn transforms(cameras: &[(String, Camera)]) -> Value {
    let k = cameras[0].1.intrinsics;
    let frames: Vec<Value> = cameras
        .iter()
        .filter(|(name, _)| name != LOST)
        .map(|(name, camera)| {
            let turned = DMat4::from_quat(DQuat::from_rotation_y(12_f64.to_radians()));
            let seen = match name == MOVED {
                true => turned * camera.world_to_camera,
                false => camera.world_to_camera,
            };
            let to_world = seen.inverse() * DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
            json!({
                "file_path": format!("images/{name}.png"),
                "transform_matrix": to_world.transpose().to_cols_array_2d(),
            })
        })
        .collect();
    json!({
        "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
        "frames": frames,
    })
}

fn verdict<'a>(poses: &'a Value, name: &str) -> &'a Value {
    let verdicts = poses["verdicts"].as_array().expect("verdicts");
    let mut named = verdicts.iter().filter(|verdict| verdict["name"] == name);
    named.next().unwrap_or_else(|| panic!("nothing is said of {name}: {verdicts:?}"))
}

fn centre(file: &Path, name: &str) -> DVec3 {
    let cameras = json(file);
    let cameras = cameras.as_array().expect("a list");
    let camera = cameras.iter().find(|camera| camera["name"] == name);
    let rows = &camera.unwrap_or_else(|| panic!("no camera of {name}"))["world_to_camera"];
    let value = |row: usize, column: usize| rows[row][column].as_f64().expect("a number");
    let columns = [0, 1, 2, 3].map(|c| [0, 1, 2, 3].map(|r| value(r, c)));
    DMat4::from_cols_array_2d(&columns).inverse().w_axis.truncate()
}

/// Generates the capture; returns its cameras.
fn capture(folder: &Path) -> Vec<(String, Camera)> {
    let options = SynthOptions {
        views: 12,
        width: 256,
        height: 160,
        seed: 3,
        blur: 3.0,
        ..SynthOptions::default()
    };
    let made = generate(&options, folder).expect("a synthetic capture");
    std::fs::remove_file(folder.join("poses_bounds.npy")).expect("there");
    let poses = transforms(&made.cameras).to_string();
    std::fs::write(folder.join("transforms.json"), poses).expect("written");
    for (name, _) in &made.cameras {
        let path = folder.join(format!("images/{name}.png"));
        let number: usize = name.parse().expect("a number");
        let gains = Gains { stops: [STOPS[number % 4]; 3] };
        let photograph = Image::load(&path).expect("a photograph");
        gains.expose(&photograph).save(&path).expect("written");
    }
    made.cameras
}

/// Runs two rounds; returns the log.
fn run(capture: &Path, out: &Path, late_views: bool) -> String {
    let mut command = fled();
    command.arg("run").arg(capture).arg("--out").arg(out);
    command.args(["--preset", "preview", "--cache", "none"]);
    for set in ["size=256", "steps=200", "cap=4000", "pose_source=given", "held_out=none"] {
        command.args(["--set", set]);
    }
    let late_views = format!("late_views={late_views}");
    command.args(["--set", "rounds=2", "--set", &late_views]);
    let output = succeed(&mut command);
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Largest distance between two cameras.
fn extent(cameras: &[(String, Camera)]) -> f64 {
    let centres = || cameras.iter().map(|(_, camera)| camera.centre());
    let pairs = centres().flat_map(|a| centres().map(move |b| a.distance(b)));
    pairs.fold(0.0, f64::max)
}

#[test]
fn lost_and_misplaced_photographs_join_at_the_right_place() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (place, out) = (folder.path().join("capture"), folder.path().join("out"));
    let cameras = capture(&place);
    let log = run(&place, &out, true);
    let poses = json(&out.join("poses.json"));
    assert_eq!(poses["registered"], 12, "{log}");
    for name in [LOST, MOVED] {
        assert_eq!(verdict(&poses, name)["status"], "late", "{name}: {log}");
        let (_, truth) = cameras.iter().find(|(view, _)| view == name).expect("made");
        let away = centre(&out.join("cameras.json"), name).distance(truth.centre());
        assert!(away < 0.03 * extent(&cameras), "{name} is {away} away: {log}");
    }
    assert_eq!(verdict(&poses, "001")["status"], "registered");
    assert!(verdict(&poses, "001")["fit"].as_f64().is_some_and(|fit| fit > 0.7));
    let metrics = json(&out.join("metrics.json"));
    let registered = |round: usize| {
        let rows = metrics["rounds"][round]["views"].as_array().expect("rows");
        rows.iter().filter(|row| row["registered"] == true).count()
    };
    assert_eq!((registered(0), registered(1)), (11, 12));
    let stops = |name: &str| {
        let view = &metrics["exposure"]["views"][name];
        view["stops"].as_f64().unwrap_or_else(|| panic!("{name}: {}", metrics["exposure"]))
    };
    for (name, own) in [(LOST, STOPS[0]), (MOVED, STOPS[3])] {
        let apart = stops(name) - stops("005") - (own - STOPS[1]);
        assert!(apart.abs() < 0.1, "{name}: {apart}: {}", metrics["exposure"]);
    }
    // The search is not repeated.
    let again = run(&place, &out, true);
    assert!(again.contains("its result stands"), "{again}");
    assert_eq!(json(&out.join("poses.json")), poses, "the scene's say stands, too");
    // When disabled, no view joins or leaves, and the first round is reused.
    let off = run(&place, &out, false);
    assert!(off.contains("round 1 reconstruct already done"), "{off}");
    assert_eq!(json(&out.join("poses.json"))["registered"], 11);
}
