//! Benchmark of blending.

use std::time::Instant;

use fled_gpu::{Gpu, Recording};

use super::*;

/// Number of measured, and then of profiled runs.
const RUNS: f64 = 20.0;

/// Prints times. Run with `cargo test --release -p fled-core blending_times -- --ignored
/// --nocapture`.
#[test]
#[ignore = "a measurement"]
fn blending_times() {
    let gpu = fixtures::gpu();
    let (width, height, n) = (1120, 640, 200_000);
    let mut gaussians = fixtures::gaussians(n, 0, 3);
    gaussians.log_scales.iter_mut().flatten().for_each(|s| *s -= 0.55);
    let view = fixtures::viewpoint(width, height);
    let device = DeviceGaussians::upload(gpu, &gaussians, n).unwrap();
    let projection = Projection::new(gpu, n).unwrap();
    projection.camera.write(&[CameraUniform::new(&view.camera, n, 0, 0, 0.1)]).unwrap();
    let sizes = SplatSizes { gaussians: n, width, height, intersections: 20 * n };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    let gradient = gpu.upload("image gradient", &vec![0.5_f32; 3 * width * height]).unwrap();
    for specialisation in specialisations() {
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).unwrap();
        Forward::new(specialisation).record(&mut recorder, &projection, &buffers).unwrap();
        let backward = Backward::new(specialisation);
        backward.record(&mut recorder, &projection, &buffers, &gradient).unwrap();
        let best = shortest(gpu, &recorder.finish());
        eprintln!(
            "{specialisation:?}: {:.1} ms, {:?}",
            best * 1e3,
            buffers.counts().unwrap().wait()
        );
        for (name, time) in gpu.profiled() {
            let per_step = time.shortest.as_secs_f64() * 1e3 * time.dispatches as f64 / RUNS;
            eprintln!("  {name}: {per_step:.2} ms a step");
        }
        gpu.profile(false);
    }
}

/// Seconds of the fastest of several runs; then profiles as many.
fn shortest(gpu: &Gpu, recording: &Recording) -> f64 {
    let runs = 0..RUNS as u32;
    recording.submit().unwrap();
    gpu.wait().unwrap();
    let mut best = f64::INFINITY;
    for _ in runs.clone() {
        let start = Instant::now();
        recording.submit().unwrap();
        gpu.wait().unwrap();
        best = best.min(start.elapsed().as_secs_f64());
    }
    gpu.profile(true);
    runs.for_each(|_| recording.submit().map(|_| ()).unwrap());
    best
}
