//! Tests of a job from photographs to scene, and of its interruptions.

use std::fs;

use fled_core::gaussians::ply;
use fled_core::image::Image;
use fled_core::synthetic::{SynthOptions, generate};

use crate::support::{
    fled, json, kill_at, small_capture, small_capture_shaken_by, small_run, succeed,
};

#[test]
fn a_dark_capture_becomes_a_scene_with_metrics_of_every_round() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    succeed(small_run(&capture, &out, 2).args(["--set", "steps=120"]));

    let report = json(&out.join("metrics.json"));
    assert_eq!(report["rounds"].as_array().expect("rounds").len(), 2);
    assert_eq!(report["registered"], 12);
    let psnr = |image: &str, split: &str, reference: &str| {
        let records = report["rounds"][1]["records"].as_array().expect("records");
        let of = |r: &&serde_json::Value| {
            r["split"] == split && r["image"] == image && r["reference"] == reference
        };
        records.iter().find(of).expect("a record")["psnr_cc_db"].as_f64().expect("dB")
    };
    // 120 steps make no good scene, but an empty render scores 13 dB here.
    assert!(psnr("render", "train", "gt") > 17.0, "training views: {report:#}");
    assert!(psnr("render", "held_out", "gt") > 16.5, "held-out views: {report:#}");
    assert!(psnr("enhanced", "held_out", "gt") > 20.0, "the brightened views: {report:#}");
    let scene = ply::read(&out.join("scene.ply")).expect("a scene");
    assert!(!scene.gaussians.is_empty());
    assert_eq!(json(&out.join("cameras.json")).as_array().expect("cameras").len(), 12);
    let restored = fs::read_dir(out.join("restored")).expect("restored views").count();
    assert_eq!(restored, 12);
    assert_eq!(json(&out.join("config.json"))["rounds"], 2);
}

#[test]
fn a_still_capture_is_splatted_plainly_in_one_round() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture_shaken_by(folder.path(), 0.0);
    let out = folder.path().join("out");
    let run = || {
        let mut run = small_run(&capture, &out, 2);
        run.args(["--set", "train_on=auto", "--set", "rounds=auto"]);
        String::from_utf8(succeed(&mut run).stderr).expect("UTF-8")
    };
    let log = run();
    assert!(log.contains("0 of 12 views are shaken"), "{log}");
    let report = json(&out.join("metrics.json"));
    assert_eq!(report["shaken_views"], 0);
    assert_eq!(report["config"]["rounds"], "auto", "what was asked for");
    assert_eq!(report["in_effect"]["refine_poses"], false);
    let rounds = report["rounds"].as_array().expect("rounds");
    assert_eq!((rounds.len(), &rounds[0]["kernels"]), (1, &0.into()));
    assert!(out.join("scene.ply").exists());
    assert!(run().contains("its result stands"));
}

#[test]
fn equal_seeds_give_equal_scenes_and_other_seeds_do_not() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let scene = |name: &str, seed: &str| {
        let out = folder.path().join(name);
        succeed(small_run(&capture, &out, 1).args(["--set", seed]));
        fs::read(out.join("scene.ply")).expect("scene.ply")
    };
    let first = scene("a", "seed=1");
    assert!(first == scene("b", "seed=1"), "equal runs differ");
    assert!(first != scene("c", "seed=2"), "the seed changes nothing");
}

#[test]
fn a_run_killed_at_any_stage_resumes_to_the_same_scene() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let whole = folder.path().join("whole");
    succeed(&mut small_run(&capture, &whole, 2));
    let expected = fs::read(whole.join("scene.ply")).expect("scene.ply");

    let out = folder.path().join("killed");
    let moments = [
        r#""stage_started","stage":"deblur","round":1"#,
        r#""stage_advanced","stage":"reconstruct","round":1"#,
        r#""stage_started","stage":"match","round":1"#,
        r#""stage_advanced","stage":"deblur","round":2"#,
        r#""stage_started","stage":"evaluate","round":2"#,
    ];
    for moment in moments {
        kill_at(&mut small_run(&capture, &out, 2), moment);
    }
    succeed(&mut small_run(&capture, &out, 2));
    let resumed = fs::read(out.join("scene.ply")).expect("scene.ply");
    assert!(resumed == expected, "a resumed run must deliver what an undisturbed one does");
    let log = fs::read_to_string(out.join("log.txt")).expect("log.txt");
    assert!(log.contains("already done"), "the rerun must have skipped finished stages:\n{log}");
}

#[test]
fn a_run_killed_while_it_matches_photographs_continues_with_the_pairs_it_has() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = folder.path().join("capture");
    let options =
        SynthOptions { views: 10, width: 240, height: 136, seed: 4, ..SynthOptions::default() };
    generate(&options, &capture).expect("a synthetic capture");
    let out = folder.path().join("killed");
    let run = || {
        let mut run = small_run(&capture, &out, 1);
        run.args(["--set", "pose_source=colmap"]);
        run
    };
    kill_at(&mut run(), r#""done":30,"total":55"#);
    succeed(&mut run());
    let log = fs::read_to_string(out.join("log.txt")).expect("log.txt");
    let (rest, _) = log.rsplit_once(" of 45 pairs were compared by an").expect("a line");
    let kept: u32 = rest.rsplit(' ').next().expect("a number").parse().expect("a number");
    // Two more threads may have finished a pair before they were killed.
    assert!((20..=45).contains(&kept), "{kept} of 45 pairs");
}

#[test]
fn a_finished_run_is_not_repeated_but_files_that_are_gone_are_delivered_again() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    let run = || {
        succeed(&mut small_run(&capture, &out, 1));
        let trained = fs::metadata(out.join("rounds/1/scene.ply")).expect("scene");
        trained.modified().expect("time")
    };
    let written = run();
    assert_eq!(run(), written);
    for name in ["scene.ply", "cameras.json"] {
        let path = out.join(name);
        let delivered = fs::read(&path).expect("delivered");
        fs::remove_file(&path).expect("removed");
        assert_eq!(run(), written, "trained again");
        assert!(fs::read(&path).expect("delivered again") == delivered, "another {name}");
    }
}

#[test]
fn only_discarded_work_is_deblurred_again_for_new_training() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    let log = || fs::read_to_string(out.join("log.txt")).expect("log.txt");
    let mut read = 0;
    let mut run = |arguments: &[&str]| {
        succeed(small_run(&capture, &out, 1).args(arguments));
        let whole = log();
        let said = whole[read..].to_owned();
        read = whole.len();
        said
    };
    run(&[]);
    let retrained = run(&["--set", "cap=1200", "--discard-work"]);
    assert!(retrained.contains("round 1 deblur already done"), "{retrained}");
    assert!(retrained.contains("round 1 reconstruct done"), "{retrained}");
    let discarded = run(&["--set", "cap=1100"]);
    assert!(discarded.contains("round 1 deblur done"), "{discarded}");
}

#[test]
fn a_finished_run_renders_from_a_view_and_an_orbit() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let capture = small_capture(folder.path());
    let out = folder.path().join("out");
    succeed(&mut small_run(&capture, &out, 1));
    let name = json(&out.join("cameras.json"))[1]["name"].as_str().expect("name").to_owned();
    let picture = |arguments: &[&str]| {
        let path = folder.path().join("picture.png");
        let mut command = fled();
        succeed(command.arg("render").arg(&out).args(arguments).arg("-o").arg(&path));
        Image::load(&path).expect("a picture")
    };
    let view = picture(&["--view", &name]);
    assert_eq!((view.width(), view.height()), (128, 80));
    let restored =
        Image::load(&out.join("restored").join(format!("{name}.png"))).expect("restored");
    let psnr = fled_core::metrics::psnr(&view, &restored);
    assert!(psnr > 45.0, "`fled render` and the pipeline disagree: {psnr:.1} dB");
    let path = folder.path().join("picture.tif");
    let mut command = fled();
    command.arg("render").arg(&out).args(["--view", &name, "--ev", "-1", "-o"]).arg(&path);
    succeed(command.arg("--linear"));
    let light = Image::load_light(&path, usize::MAX).expect("a TIFF").get(64, 40)[1];
    let wanted = 0.5 * view.to_linear().get(64, 40)[1];
    assert!((light - wanted).abs() < 0.004, "{light} {wanted}");
    let orbit = picture(&["--azimuth", "10", "--elevation", "-3", "--size", "96x64"]);
    assert_eq!((orbit.width(), orbit.height()), (96, 64));
    assert!(fled_core::metrics::mean_v(&orbit) > 0.02, "the orbit looks at nothing");
}
