//! The noise field for processors against the reference.

use fled_cpu::View;

use super::super::processor;
use super::*;
use crate::splat::processor::view;
use crate::splat::uniform::CameraUniform;

/// A field with its images.
struct Case {
    field: fled_cpu::noise::NoiseField,
    camera: Camera,
    render: Vec<f32>,
    gradient: Vec<f32>,
}

impl Case {
    fn new(width: usize, height: usize) -> Self {
        let values = |f: f32, scale: f32| -> Vec<f32> {
            (0..3 * width * height).map(|i| scale * (0.5 + 0.4 * (f * i as f32).sin())).collect()
        };
        Self {
            field: processor::field(7),
            camera: camera(width, height, 0.3),
            render: values(0.013, 1.0),
            gradient: values(0.37, 1e-3),
        }
    }

    fn view(&self) -> View {
        view(&CameraUniform::new(&self.camera, 0, 0, 0, 0.01))
    }

    fn step(&mut self) -> Vec<f32> {
        let mut prediction = Vec::new();
        self.field.forward(&self.view(), &self.render, &mut prediction);
        self.field.backward(&self.view(), &self.gradient);
        prediction
    }

    fn parameters(&self) -> Vec<f64> {
        wide(&self.field.numbers()[..fled_cpu::noise::PARAMETERS])
    }

    /// Map and parameter gradients, each by the processor's kernels and by the reference.
    fn compare(&self) -> [(Vec<f32>, Vec<f64>); 2] {
        let parameters = self.parameters();
        let reference = ReferenceNoise::new(&parameters, &self.camera);
        let mut prediction = vec![0.0; 5];
        self.field.forward(&self.view(), &self.render, &mut prediction);
        let map = prediction.iter().zip(&self.render).map(|(p, r)| p - r).collect();
        let gradients = self.field.gradient(&self.view(), &self.gradient);
        let expected = reference.gradient(&wide(&self.gradient));
        [(map, reference.map()), (gradients, expected)]
    }
}

#[test]
fn map_and_gradients_match_the_reference() {
    // Less than a block, several strips of the image, and columns rather than rows.
    for (width, height) in [(13, 9), (150, 7), (5, 81), (1, 1)] {
        let [map, gradients] = Case::new(width, height).compare();
        assert_agrees("map", &map.0, &map.1, 1e-5);
        assert_agrees("gradients", &gradients.0, &gradients.1, 1e-4);
        for (n, layer) in Network::new().layers.iter().enumerate() {
            let of = 4 * layer.weights4..4 * (layer.biases4 + layer.outputs4);
            let (found, expected) = (&gradients.0[of.clone()], &gradients.1[of]);
            assert_agrees(&format!("gradients of layer {n}"), found, expected, 1e-3);
        }
    }
}

#[test]
fn the_comparison_detects_another_camera_and_a_missing_direction() {
    let case = Case::new(13, 9);
    let [map, gradients] = case.compare();
    let parameters = case.parameters();
    let turned = camera(13, 9, 0.6);
    let other = ReferenceNoise::new(&parameters, &turned);
    assert!(!agreement(&map.0, &other.map()).within(1e-3));
    let colour = Network::new().layers[4];
    let mut without = gradients.1.clone();
    without[colour.weight(network::HIDDEN, 0)..4 * colour.biases4].fill(0.0);
    assert!(!agreement(&gradients.0, &without).within(1e-3));
}

#[test]
fn steps_of_adam_follow_the_formula() {
    let mut case = Case::new(13, 9);
    case.step();
    // The rate falls after a hundred steps, and the moments are not those of a first step.
    for step in [0, 1, 99, 100, 250] {
        let numbers = case.field.numbers().to_vec();
        case.field = fled_cpu::noise::NoiseField::new(step, numbers.clone()).expect("as many");
        let gradients = case.field.gradient(&case.view(), &case.gradient);
        case.step();
        assert_eq!(case.field.step(), step + 1);
        let rate = RATE * DECAY.powi((step / DECAY_STEPS) as i32);
        let count = gradients.len();
        let mut moved = 0.0_f64;
        for (i, g) in gradients.iter().map(|&g| f64::from(g)).enumerate() {
            let before = |n: usize| f64::from(numbers[n * count + i]);
            let [m, v] = [0.9 * before(1) + 0.1 * g, 0.999 * before(2) + 0.001 * g * g];
            let corrected = |moment: f64, beta: f64| moment / (1.0 - beta.powi(step as i32 + 1));
            let taken = rate * corrected(m, 0.9) / (corrected(v, 0.999).sqrt() + 1e-8);
            // The terms of a sum may cancel each other.
            let terms = [1e-3 + before(0).abs(), before(1).abs() + g.abs(), v];
            for (n, expected) in [before(0) - taken, m, v].into_iter().enumerate() {
                let found = f64::from(case.field.numbers()[n * count + i]);
                let error = (found - expected).abs();
                assert!(error < 5e-7 * terms[n] + 1e-18, "{n}: {found} {expected}");
            }
            moved = moved.max(taken.abs());
        }
        assert!(moved > 0.5 * rate, "{moved}");
    }
}

#[test]
fn non_finite_gradients_change_nothing() {
    let mut case = Case::new(13, 9);
    let before = case.field.numbers().to_vec();
    case.gradient.fill(f32::NAN);
    case.step();
    assert_eq!(case.field.numbers(), before);
}

#[test]
fn a_saved_field_resumes_exactly_and_other_states_are_refused() {
    let mut first = Case::new(13, 9);
    first.step();
    let saved = processor::save(&first.field);
    let mut second = Case::new(13, 9);
    second.field = processor::restore(&saved).expect("the same field");
    first.step();
    second.step();
    let resumed = processor::save(&second.field);
    assert_eq!(processor::save(&first.field), resumed);
    assert_ne!(resumed, saved);
    let mut older = saved.clone();
    older[0] -= 1.0;
    assert!(matches!(processor::restore(&older), Err(StateError::Format(_))));
    assert!(matches!(processor::restore(&saved[1..]), Err(StateError::Format(_))));
}

#[test]
fn a_step_on_a_gpu_equals_one_on_a_processor_in_states_of_one_form() {
    let (mut gpu, mut case) = (Fixture::new(13, 9), Case::new(13, 9));
    gpu.step();
    case.field = processor::restore(&gpu.field.save().expect("read")).expect("one form");
    gpu.step();
    case.step();
    let (gpu, processor) = (gpu.field.save().expect("read"), processor::save(&case.field));
    assert_eq!(gpu[..2], processor[..2]);
    let worst = gpu.iter().zip(&processor).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 2e-5, "{worst}");
}
