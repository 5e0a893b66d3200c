//! Tests of edge cases: empty images, covering splats, and overflow.

use super::*;

#[test]
fn nothing_visible_gives_black_and_full_transmittance() {
    let mut gaussians = fixtures::gaussians(40, 0, 3);
    gaussians.means.fill([0.0, 0.0, -60.0]);
    let run = Case::new(gaussians, 64, 48).run(chosen());
    assert_eq!((run.counts.visible, run.counts.intersections), (0, 0));
    assert!(run.image.iter().all(|&v| v == 0.0) && run.transmittance.iter().all(|&v| v == 1.0));
    let empty = Case::new(Gaussians::default(), 64, 48).run(chosen());
    assert!(empty.transmittance.iter().all(|&v| v == 1.0));
}

#[test]
fn a_splat_over_all_tiles_covers_the_image() {
    let mut gaussians = fixtures::gaussians(3, 0, 3);
    gaussians.means.fill([0.0; 3]);
    gaussians.log_scales.fill([2.5; 3]);
    gaussians.opacity_logits = vec![0.0, 9.0, 9.0];
    let scene = Case::new(gaussians, 90, 70);
    let run = scene.run(chosen());
    assert_eq!(run.tile_counts, [30; 3]);
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    assert!(run.transmittance.iter().all(|&t| t < 0.6));
}

#[test]
fn a_camera_sees_the_splat_it_is_in_but_none_behind_it() {
    let mut gaussians = fixtures::gaussians(60, 0, 3);
    let camera = fixtures::viewpoint(90, 70).camera;
    let at = |depth: f64| (camera.centre() + depth * camera.forward()).to_array().map(|x| x as f32);
    gaussians.means[..3].copy_from_slice(&[at(0.15), at(0.0), at(-0.5)]);
    gaussians.log_scales[..3].fill([0.0; 3]);
    gaussians.opacity_logits[..3].fill(0.0);
    let scene = Case::new(gaussians, 90, 70);
    let run = scene.run(chosen());
    assert_eq!(run.tile_counts[..3], [30, 0, 0]);
    let expected = scene.reference(&run);
    mostly_within(&run.image, &expected.image, 1e-4, 1e-3).unwrap();
    assert!(run.transmittance.iter().all(|&t| t < 0.7));
    let upstream: Vec<_> = scene.image_gradient.iter().map(|&v| f64::from(v)).collect();
    let by_splat = blend_backward(&run.projected, &expected, &upstream);
    let (found, expected) = (run.gradients()[0], flat(&by_splat[0]));
    gradients_agree(&found, &expected).unwrap();
}

#[test]
fn an_overflow_is_counted_exactly_and_more_room_fixes_it() {
    let mut scene = Case::new(fixtures::gaussians(500, 0, 9), 96, 64);
    let enough = scene.run(chosen());
    scene.intersections = 300;
    let short = scene.run(chosen());
    assert!(short.counts.overflowed() && short.counts.intersections == enough.counts.intersections);
    assert_eq!(short.counts.capacity, 300);
    scene.intersections = enough.counts.intersections;
    let exact = scene.run(chosen());
    assert!(!exact.counts.overflowed() && exact.image == enough.image);
}

#[test]
fn a_tile_counted_but_not_emitted_has_no_effect() {
    let gpu = fixtures::gpu();
    let gaussians = fixtures::gaussians(400, 0, 3);
    let (n, width, height) = (gaussians.len(), 96, 64);
    let device = DeviceGaussians::upload(gpu, &gaussians, n).unwrap();
    let projection = Projection::new(gpu, n).unwrap();
    let view = fixtures::viewpoint(width, height);
    projection.camera.write(&[CameraUniform::new(&view.camera, n, 0, 0, 0.1)]).unwrap();
    let sizes = SplatSizes { gaussians: n, width, height, intersections: 20_001 };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    // Mark the rows, so that unwritten ones are visible.
    buffers.slots.write(&vec![[7.0; SLOT_ROW]; 20_001]).unwrap();
    let gradient = gpu.upload("image gradient", &vec![1.0_f32; 3 * width * height]).unwrap();
    let mut recorder = gpu.recorder();
    projection.record(&mut recorder, &device).unwrap();
    recorder.submit().unwrap();
    let mut recorder = gpu.recorder();
    Forward::new(chosen()).record(&mut recorder, &projection, &buffers).unwrap();
    Backward::new(chosen()).record(&mut recorder, &projection, &buffers, &gradient).unwrap();
    let recording = recorder.finish();
    recording.submit().unwrap();
    let image = buffers.image.read().unwrap();
    let mut spans = projection.spans.read().unwrap();
    let changed = (1..=n).find(|&row| spans[row][1] > 0).unwrap();
    spans[changed][1] += 1;
    projection.spans.write(&spans).unwrap();
    recording.submit().unwrap();
    assert!(buffers.image.read().unwrap() == image);
    let [first, tiles] = projection.spans.read().unwrap()[changed];
    let slot = (first + tiles - 1) as usize;
    let rows = buffers.slots.read().unwrap();
    assert_eq!(rows[slot], [0.0; SLOT_ROW]);
}

#[test]
fn a_camera_larger_than_the_buffers_draws_nothing() {
    let gpu = fixtures::gpu();
    let gaussians = fixtures::gaussians(200, 0, 3);
    let device = DeviceGaussians::upload(gpu, &gaussians, 200).unwrap();
    let projection = Projection::new(gpu, 200).unwrap();
    let sizes = SplatSizes { gaussians: 200, width: 64, height: 48, intersections: 20_000 };
    let buffers = SplatBuffers::new(gpu, sizes, true).unwrap();
    let mut recorder = gpu.recorder();
    projection.record(&mut recorder, &device).unwrap();
    Forward::new(chosen()).record(&mut recorder, &projection, &buffers).unwrap();
    let gradient = gpu.create::<f32>("image gradient", 3 * 64 * 48).unwrap();
    Backward::new(chosen()).record(&mut recorder, &projection, &buffers, &gradient).unwrap();
    let recording = recorder.finish();
    let draw = |width, height| {
        let camera = fixtures::viewpoint(width, height).camera;
        projection.camera.write(&[CameraUniform::new(&camera, 200, 0, 0, 0.1)]).unwrap();
        recording.submit().unwrap();
        buffers.image.read().unwrap()
    };
    assert!(draw(640, 480).iter().all(|&v| v == 0.0));
    assert!(draw(64, 48).iter().any(|&v| v > 0.0));
}
