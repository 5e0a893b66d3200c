mod processor;

use glam::DVec3;

use super::kernels::LayerUniform;
use super::reference::ReferenceNoise;
use super::*;
use crate::agreement::{agreement, assert_agrees};
use crate::camera::Intrinsics;

pub(super) fn camera(width: usize, height: usize, turn: f64) -> Camera {
    let (w, h) = (width as f64, height as f64);
    let intrinsics = Intrinsics { width, height, fx: w, fy: w, cx: 0.48 * w, cy: 0.53 * h };
    Camera::look_at(intrinsics, DVec3::new(turn, -0.4, -3.0), DVec3::new(0.1, 0.2, 0.3), DVec3::Y)
}

fn gpu() -> Gpu {
    Gpu::new("auto").expect("the tests need a Vulkan adapter")
}

/// A field with its images.
struct Fixture {
    gpu: Gpu,
    field: NoiseField,
    camera: Camera,
    render: Buffer<f32>,
    prediction: Buffer<f32>,
    gradient: Buffer<f32>,
    intersections: Buffer<u32>,
}

impl Fixture {
    fn new(width: usize, height: usize) -> Self {
        let gpu = gpu();
        let field = NoiseField::new(&gpu, 7, [width, height]).expect("buffers");
        let values = |f: f32, scale: f32| -> Vec<f32> {
            (0..3 * width * height).map(|i| scale * (0.5 + 0.4 * (f * i as f32).sin())).collect()
        };
        Self {
            render: gpu.upload("render", &values(0.013, 1.0)).expect("upload"),
            prediction: gpu.create("prediction", 3 * width * height).expect("buffer"),
            gradient: gpu.upload("gradient", &values(0.37, 1e-3)).expect("upload"),
            camera: camera(width, height, 0.3),
            intersections: gpu.upload("intersections", &[0, 100]).expect("upload"),
            gpu,
            field,
        }
    }

    fn step(&mut self) {
        self.step_with_room_for(100);
    }

    fn step_with_room_for(&mut self, capacity: u32) {
        self.field.begin_step(&self.camera).expect("fits");
        let mut recorder = self.gpu.recorder();
        self.field.record_forward(&mut recorder, &self.render, &self.prediction).expect("recorded");
        let limit = IntersectionLimit { counters: &self.intersections, total_at: 1, capacity };
        self.field.record_backward(&mut recorder, &self.gradient, &limit).expect("recorded");
        recorder.submit().expect("submitted");
    }

    /// Map and parameter gradients, each by the device and by the reference.
    fn compare(&mut self) -> [(Vec<f32>, Vec<f64>); 2] {
        let before: Vec<f64> =
            wide(self.field.buffers.parameters.read().expect("read").as_flattened());
        self.step();
        let reference = ReferenceNoise::new(&before, &self.camera);
        let (render, prediction) =
            (self.render.read().expect("read"), self.prediction.read().expect("read"));
        let map = prediction.iter().zip(&render).map(|(p, r)| p - r).collect();
        let segments = self.field.buffers.gradients.read().expect("read");
        let mut gradients = vec![0.0; before.len()];
        for segment in segments.as_flattened().chunks(before.len()) {
            gradients.iter_mut().zip(segment).for_each(|(sum, part)| *sum += part);
        }
        let expected = reference.gradient(&wide(&self.gradient.read().expect("read")));
        [(map, reference.map()), (gradients, expected)]
    }
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

#[test]
fn map_and_gradients_match_the_reference() {
    let [map, gradients] = Fixture::new(13, 9).compare();
    assert_agrees("map", &map.0, &map.1, 1e-3);
    assert_agrees("gradients", &gradients.0, &gradients.1, 1e-3);
}

#[test]
fn the_comparison_detects_wrong_amplitudes_and_layers() {
    let [map, gradients] = Fixture::new(13, 9).compare();
    let louder: Vec<f64> = map.1.iter().map(|n| 1.01 * n).collect();
    assert!(!agreement(&map.0, &louder).within(1e-3));
    let first = &Network::new().layers[1];
    let mut without = gradients.1.clone();
    without[4 * first.weights4..4 * first.biases4].fill(0.0);
    assert!(!agreement(&gradients.0, &without).within(1e-3));
}

#[test]
fn many_chunks_equal_one_chunk() {
    let mut whole = Fixture::new(13, 9);
    let mut parts = Fixture::new(13, 9);
    parts.field.chunk_pixels = 16;
    parts.field.buffers =
        Buffers::new(&parts.gpu, &parts.field.network, 13 * 9, 16).expect("buffers");
    let start = whole.field.buffers.parameters.read().expect("read");
    parts.field.buffers.parameters.write(&start).expect("written");
    let ([map, gradients], [map_2, gradients_2]) = (whole.compare(), parts.compare());
    assert_agrees("map", &map_2.0, &wide(&map.0), 1e-5);
    assert_agrees("gradients", &gradients_2.0, &wide(&gradients.0), 1e-5);
}

#[test]
fn one_step_of_adam_follows_its_formula() {
    let mut fixture = Fixture::new(13, 9);
    let before = fixture.field.buffers.parameters.read().expect("read");
    let [_, gradients] = fixture.compare();
    let after = fixture.field.buffers.parameters.read().expect("read");
    let pairs = before.as_flattened().iter().zip(after.as_flattened());
    for ((before, after), g) in pairs.zip(&gradients.0) {
        // In the first step the corrected moments are g and g^2.
        let expected = f64::from(*before) - RATE * f64::from(*g) / (f64::from(g.abs()) + 1e-8);
        assert!((f64::from(*after) - expected).abs() < 1e-6, "{before} {after} {expected}");
    }
}

#[test]
fn a_field_learns_a_smooth_cast() {
    let (width, height) = (13, 9);
    let mut fixture = Fixture::new(width, height);
    let plane = width * height;
    let cast = |i: usize| {
        if i / plane == 0 { 0.05 + 0.03 * ((i % width) as f32 / width as f32 - 0.5) } else { 0.05 }
    };
    let render = fixture.render.read().expect("read");
    let mut errors = Vec::new();
    for _ in 0..300 {
        fixture.step();
        let prediction = fixture.prediction.read().expect("read");
        let error = |i: usize| prediction[i] - render[i] - cast(i);
        let gradient: Vec<f32> = (0..3 * plane).map(|i| 2.0 * error(i) / plane as f32).collect();
        errors.push((0..3 * plane).map(|i| error(i).powi(2)).sum::<f32>());
        fixture.gradient.write(&gradient).expect("written");
    }
    assert!(errors[299] < 0.5 * errors[0], "{} {}", errors[0], errors[299]);
}

#[test]
fn a_saved_field_resumes_exactly_and_other_states_are_refused() {
    let mut first = Fixture::new(13, 9);
    first.step();
    let saved = first.field.save().expect("read");
    let mut second = Fixture::new(13, 9);
    second.field.restore(&saved).expect("the same field");
    first.step();
    second.step();
    assert_eq!(first.field.save().expect("read"), second.field.save().expect("read"));
    assert_ne!(first.field.save().expect("read"), saved);
    let mut older = saved.clone();
    older[0] -= 1.0;
    assert!(matches!(second.field.restore(&older), Err(StateError::Format(_))));
    assert!(matches!(second.field.restore(&saved[1..]), Err(StateError::Format(_))));
}

#[test]
fn only_a_map_like_the_render_follows_the_scene() {
    let mut fixture = Fixture::new(13, 9);
    fixture.step();
    let render = fixture.render.read().expect("read");
    let write = |fixture: &Fixture, noise: &dyn Fn(usize, f32) -> f32| {
        let values: Vec<f32> = render.iter().enumerate().map(|(i, &r)| r + noise(i, r)).collect();
        fixture.prediction.write(&values).expect("written");
    };
    write(&fixture, &|i, _| 0.01 * (i as f32 * 1.7).sin());
    let quiet = fixture.field.inspect(&fixture.render, &fixture.prediction).expect("read");
    assert!(!quiet.follows_scene && quiet.correlation.abs() < 0.1, "{quiet:?}");
    write(&fixture, &|_, r| 0.05 * r);
    let alike = fixture.field.inspect(&fixture.render, &fixture.prediction).expect("read");
    assert!(alike.follows_scene && alike.correlation > 0.99, "{alike:?}");
}

#[test]
fn non_finite_gradients_change_nothing() {
    let mut fixture = Fixture::new(13, 9);
    fixture.gradient.write(&[f32::NAN; 3 * 13 * 9]).expect("written");
    let before = fixture.field.buffers.parameters.read().expect("read");
    fixture.step();
    assert_eq!(fixture.field.buffers.parameters.read().expect("read"), before);
}

#[test]
fn a_step_whose_intersections_overflow_changes_nothing() {
    let mut fixture = Fixture::new(13, 9);
    fixture.step();
    let before = fixture.field.save().expect("read");
    fixture.step_with_room_for(99);
    fixture.field.take_back_step();
    assert_eq!(fixture.field.save().expect("read"), before);
    fixture.step();
    assert_ne!(fixture.field.save().expect("read"), before);
}

#[test]
fn wrong_sizes_are_refused() {
    let mut fixture = Fixture::new(13, 9);
    assert!(fixture.field.begin_step(&camera(26, 18, 0.0)).is_err());
    let limit = IntersectionLimit { counters: &fixture.intersections, total_at: 1, capacity: 100 };
    assert!(
        fixture
            .field
            .record_backward(&mut fixture.gpu.recorder(), &fixture.gradient, &limit)
            .is_err()
    );
}

#[test]
fn the_structs_match_the_shaders() {
    use fled_gpu::Kernel;
    let size = |kernel: &Kernel, name: &str| {
        let (_, found) = kernel.reflect().expect("the row agrees with the shader");
        let layout = found.structure(name).unwrap_or_else(|| panic!("no {name}")).clone();
        (layout.size as usize, layout.members.iter().map(|m| m.1 as usize).collect::<Vec<_>>())
    };
    let consecutive = |count: usize| (0..count).map(|i| 4 * i).collect::<Vec<_>>();
    let mut field = vec![0, 16, 32, 48, 56];
    field.extend((0..4).map(|i| 64 + 4 * i));
    for kernel in [&kernels::ENCODE, &kernels::COMPOSE, &kernels::OUTPUT_DELTA] {
        assert_eq!(size(kernel, "NoiseUniform"), (size_of::<NoiseUniform>(), field.clone()));
        assert_eq!(size(kernel, "ChunkUniform"), (size_of::<ChunkUniform>(), consecutive(4)));
    }
    assert_eq!(std::mem::offset_of!(NoiseUniform, amplitude), 64 + 8);
    for kernel in [&kernels::LAYER_FORWARD, &kernels::LAYER_BACKWARD, &kernels::LAYER_WEIGHTS] {
        assert_eq!(size(kernel, "LayerUniform"), (size_of::<LayerUniform>(), consecutive(12)));
    }
    assert_eq!(size(&kernels::ADAM, "AdamUniform"), (size_of::<AdamUniform>(), consecutive(8)));
}
