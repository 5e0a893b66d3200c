//! Tests of runs with the user's own networks.

use fled_core::image::Image;

use crate::support::{self, code, network, said};

#[test]
fn user_networks_make_the_papers_baseline() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = support::small_capture(home.path());
    let out = home.path().join("out");
    let path = |name: &str| network(name).display().to_string();
    let mut run = support::small_run(&capture, &out, 1);
    for set in [
        &format!("enhance={}", path("root3")),
        &format!("deblur={}", path("box3")),
        "noise=off",
        "shake=off",
        "refine_poses=false",
    ] {
        run.args(["--set", set]);
    }
    support::succeed(&mut run);
    let report = support::json(&out.join("metrics.json"));
    assert!(
        report["models"]["enhance"].as_str().is_some_and(|model| model.starts_with("root3.onnx ")),
        "{report:#}"
    );
    assert!(
        report["models"]["deblur"].as_str().is_some_and(|model| model.starts_with("box3.onnx ")),
        "{report:#}"
    );
    assert_eq!(report["fallbacks"], serde_json::json!([]), "one round gives no guide: {report:#}");
    let mean = |folder: &str| {
        let image = Image::load(&out.join(folder).join("001.jpg")).expect("a preview");
        image.data().iter().sum::<f32>() / image.data().len() as f32
    };
    let (dark, bright) = (mean("inputs"), mean("rounds/1/enhanced"));
    // The mean of the square roots is at most the square root of the mean.
    assert!(bright > 1.5 * dark && bright < dark.sqrt() + 0.01, "{dark} to {bright}");

    let wrong = support::small_run(&capture, &home.path().join("wrong"), 1)
        .args(["--set", "enhance=small-u2w16"])
        .output()
        .expect("the binary starts");
    assert_eq!(code(&wrong), 4, "{}", said(&wrong));
    assert!(said(&wrong).contains("requires a guide"), "{}", said(&wrong));
}

#[test]
fn a_resumed_run_reuses_the_enhancers_results() {
    let home = tempfile::tempdir().expect("temporary folder");
    let capture = support::small_capture(home.path());
    let enhance = format!("enhance={}", network("root3").display());
    let run = |out: &str| {
        let mut run = support::small_run(&capture, &home.path().join(out), 1);
        run.args(["--set", &enhance, "--set", "deblur=identity"]);
        run
    };
    support::succeed(&mut run("whole"));
    support::kill_at(&mut run("killed"), r#""stage_started","stage":"reconstruct","round":1"#);
    support::succeed(&mut run("killed"));
    let log = std::fs::read_to_string(home.path().join("killed/log.txt")).expect("log.txt");
    assert!(log.contains("enhance already done"), "{log}");
    let scene =
        |out: &str| std::fs::read(home.path().join(out).join("scene.ply")).expect("scene.ply");
    assert!(
        scene("killed") == scene("whole"),
        "a resumed run must deliver what an undisturbed one does"
    );
}
