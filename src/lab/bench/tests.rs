//! Tests of the benchmark on a tiny scene, on a separate device, because profiling covers the whole
//! device.

use std::sync::OnceLock;

use super::*;

fn gpu() -> Device {
    let gpu = Gpu::new("auto").expect("GPU tests need a Vulkan adapter; lavapipe will do");
    Device::Gpu(gpu)
}

fn tiny() -> BenchOptions {
    BenchOptions {
        sizes: vec![(96, 64)],
        gaussians: vec![500],
        budget: Budget { seconds: 0.02, steps: 4 },
        seed: 3,
    }
}

fn report() -> Report {
    static REPORT: OnceLock<Report> = OnceLock::new();
    let measured =
        || run(&gpu(), &tiny(), &mut |_, _, _| {}, &CancelToken::new()).expect("measured");
    REPORT.get_or_init(measured).clone()
}

#[test]
fn every_case_and_its_kernels_are_in_the_table() {
    let report = report();
    let names: Vec<_> = report.cases.iter().map(|case| case.task).collect();
    assert_eq!(names, ["train", "render", "train", "train", "ssim", "sort"]);
    let table = report.table();
    for case in &report.cases {
        assert!(case.steps_per_second > 0.0 && case.gpu_peak_bytes > Some(0), "{case:?}");
        assert!(table.contains(&case.name), "{}", case.name);
        if !report.machine.timestamps {
            continue;
        }
        let (sum, wall) = (case.kernel_milliseconds.unwrap(), case.profiled_milliseconds.unwrap());
        assert!(sum > 0.0 && sum <= wall, "{}: kernels {sum} ms, step {wall} ms", case.name);
        assert!((case.kernels.iter().map(|row| row.share).sum::<f64>() - 1.0).abs() < 1e-9);
        for row in &case.kernels {
            let line = table.lines().find(|line| line.trim_start().starts_with(row.kernel));
            assert!(line.is_some(), "{} is not in the table", row.kernel);
            let runs = row.milliseconds > 0.0;
            assert_eq!((row.copies > 0.0, row.fmas > 0.0), (runs, runs), "{row:?}");
        }
    }
}

#[test]
fn the_extras_of_a_training_step_add_their_kernels() {
    let report = report();
    let kernels =
        |case: usize| report.cases[case].kernels.iter().map(|row| row.kernel).collect::<Vec<_>>();
    if !report.machine.timestamps {
        return;
    }
    let (off, render, shake, noise) = (kernels(0), kernels(1), kernels(2), kernels(3));
    let has = |names: &[&str], start: &str| names.iter().any(|name| name.starts_with(start));
    for kernel in [
        "splat/rasterize",
        "splat/rasterize_backward",
        "train/loss_similarity",
        "train/project_backward_adam",
    ] {
        assert!(has(&off, kernel), "{off:?}");
    }
    assert!(
        has(&render, "splat/rasterize") && !render.iter().any(|name| name.starts_with("train/"))
    );
    assert!(has(&shake, "shake/blur_backward") && has(&noise, "noise/layer_forward"));
    assert!(!has(&off, "noise/") && !has(&off, "shake/") && !has(&noise, "shake/"));
    let mut sort = kernels(5);
    sort.sort_unstable();
    assert_eq!(sort, ["sort/radix_count", "sort/radix_scan", "sort/radix_scatter"]);
}

#[test]
fn synthetic_scenes_are_reproducible_and_like_trained_ones() {
    let device = &Device::Processor;
    let options = BenchOptions { sizes: vec![(280, 160)], gaussians: vec![10_000], ..tiny() };
    let plan = Plan::Render { size: (280, 160), gaussians: 10_000 };
    let bench = Bench { device, options: &options, cancel: &CancelToken::new() };
    let case = plan.measure(&bench).expect("measured");
    let (visible, intersections) = (case.visible.unwrap(), case.intersections.unwrap());
    let each = intersections as f64 / visible as f64;
    assert!((2.0..3.0).contains(&each) && visible > 8_000, "{intersections} of {visible} visible");
    let again = || Workload::synthetic(device, (64, 48), 50, 9).expect("made");
    assert_eq!(again().gaussians, again().gaussians);
    let other = Workload::synthetic(device, (64, 48), 50, 10).expect("made");
    assert_ne!(again().gaussians, other.gaussians);
}

#[test]
fn the_processor_trains_and_renders_but_has_no_kernels_of_a_gpu() {
    let cancel = CancelToken::new();
    let report = run(&Device::Processor, &tiny(), &mut |_, _, _| {}, &cancel).expect("measured");
    let names: Vec<_> = report.cases.iter().map(|case| case.task).collect();
    assert_eq!(names, ["train", "render", "train", "train"]);
    let is_measured = |case: &Case| case.steps_per_second > 0.0 && case.gpu_peak_bytes.is_none();
    assert!(report.cases.iter().all(is_measured) && report.roofline.fma_gflops > 0.0);
    assert!(report.table().contains("processor"), "{}", report.table());
}

#[test]
fn the_json_has_null_for_missing_values() {
    let json = serde_json::to_value(report()).expect("JSON");
    assert_eq!(json["format"], 3);
    assert_eq!(json["cases"][0]["noise"], "off");
    assert!(json["job"].is_null() && json["cases"][4]["visible"].is_null());
}

#[test]
fn empty_options_and_cancellation_are_errors() {
    let device = &Device::Processor;
    let none = BenchOptions { sizes: Vec::new(), ..tiny() };
    let outcome = run(device, &none, &mut |_, _, _| {}, &CancelToken::new());
    assert!(matches!(outcome, Err(BenchError::Empty("size"))));
    let long = BenchOptions { budget: Budget { seconds: 1.0, steps: MOST_STEPS + 1 }, ..tiny() };
    let outcome = run(device, &long, &mut |_, _, _| {}, &CancelToken::new());
    assert!(matches!(outcome, Err(BenchError::Steps(2_001))));
    let cancel = CancelToken::new();
    cancel.cancel();
    assert!(matches!(
        run(device, &tiny(), &mut |_, _, _| {}, &cancel),
        Err(BenchError::Cancelled(_))
    ));
    let missing = Workload::of_run(std::path::Path::new("/nowhere/at/all"));
    assert!(matches!(missing, Err(BenchError::Run(message)) if message.contains("cameras.json")));
}
