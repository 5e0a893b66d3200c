mod relocation;

use glam::DVec3;

use super::*;
use crate::gaussians::Gaussians;
use crate::reconstruct::Pace;
use crate::splat::fixtures::{self, Random, cosine, relative_l2};
use crate::splat::rasterize::{SLOT_ROW, gradient};
use crate::splat::reference::{
    ProjectedGradient, Splat, Viewpoint, column, project, project_backward,
};
use crate::splat::rows::sh_row;
use crate::splat::uniform::CameraUniform;

const SCHEDULE: Schedule = Schedule {
    steps: 1_000,
    sh_degree: 3,
    resolution: false,
    pace: Pace::Adapted,
    warm: false,
    seed: 5,
};

/// Gaussians, projected, with random gradients in their slots.
struct Bench {
    gaussians: Gaussians,
    view: Viewpoint,
    device: DeviceGaussians,
    projection: Projection,
    optimizer: Optimizer,
    rows: SlotRows,
    upstream: Vec<ProjectedGradient>,
    slots: u32,
}

impl Bench {
    fn new(gaussians: Gaussians, degree: u32) -> Self {
        let gpu = fixtures::gpu();
        let view = Viewpoint { sh_degree: degree, ..fixtures::viewpoint(144, 96) };
        let device = DeviceGaussians::upload(gpu, &gaussians, 0).expect("uploaded");
        let projection = Projection::new(gpu, gaussians.len()).expect("created");
        let camera = CameraUniform::new(
            &view.camera,
            gaussians.len(),
            degree,
            gaussians.sh_degree,
            view.near as f32,
        );
        projection.camera.write(&[camera]).expect("written");
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).expect("recorded");
        recorder.submit().expect("submitted");
        let counts = projection.tile_counts(gaussians.len()).expect("read");
        let (mut spans, mut rows, mut upstream) = (vec![[0; 2]], Vec::new(), Vec::new());
        let mut random = Random::new(77);
        for &count in &counts {
            spans.push([rows.len() as u32, count]);
            let mut sum = [0.0; SLOT_ROW];
            for _ in 0..count {
                let row = [0; SLOT_ROW].map(|_| random.signed() as f32);
                sum.iter_mut().zip(row).for_each(|(s, v)| *s += f64::from(v));
                rows.push(row);
            }
            let splat = project(&Splat::from_gaussians(&gaussians, upstream.len()), &view);
            upstream.push(
                splat.map_or_else(ProjectedGradient::default, |p| {
                    gradient(&sum, p.conic, p.opacity)
                }),
            );
        }
        let slots = rows.len() as u32;
        spans[0][0] = slots;
        projection.spans.write(&spans).expect("written");
        let uploaded = SlotRows::new(gpu, slots as usize, true).expect("created");
        uploaded.write(&rows).expect("written");
        Self {
            optimizer: Optimizer::new(gpu, &device, false).expect("created"),
            rows: uploaded,
            gaussians,
            view,
            device,
            projection,
            upstream,
            slots,
        }
    }

    fn step(&self, kernel: &Kernel, uniform: StepUniform) {
        let uniform = StepUniform { capacity: self.slots, ..uniform };
        self.optimizer.step.write(&[uniform]).expect("written");
        let mut recorder = fixtures::gpu().recorder();
        let optimizer = &self.optimizer;
        optimizer
            .record_as(kernel, &mut recorder, &self.device, &self.projection, &self.rows)
            .expect("recorded");
        recorder.submit().expect("submitted");
    }

    /// The kernel's gradients: mean, log-scale, quaternion, logit, harmonics, by Gaussian.
    fn gradients(&self) -> Vec<Vec<f64>> {
        self.step(&PROJECT_BACKWARD_ADAM.with(&[("WRITE_GRADIENTS", 1)]), StepUniform::default());
        let count = self.gaussians.len();
        let geometry = self.optimizer.read_geometry_moments(count).expect("read");
        let sh = self.optimizer.sh_moments.read(count).expect("read");
        let (row, stride) =
            (3 * self.gaussians.coefficients(), 2 * sh_row(self.gaussians.sh_degree));
        (0..self.gaussians.len())
            .map(|i| {
                let head = geometry[i].first.iter();
                head.chain(&sh[stride * i..stride * i + row]).map(|v| f64::from(*v)).collect()
            })
            .collect()
    }
}

#[test]
fn gradients_of_every_parameter_match_the_reference() {
    for degree in [0, 2, 3] {
        let bench = Bench::new(fixtures::gaussians(300, 3, 4), degree);
        let found = bench.gradients();
        let expected: Vec<_> = (0..300)
            .map(|i| {
                let splat = Splat::from_gaussians(&bench.gaussians, i);
                project_backward(&splat, &bench.view, &bench.upstream[i]).flatten()
            })
            .collect();
        let harmonics = column::HARMONICS..column::HARMONICS + 3 * 16;
        let opacity = column::OPACITY_LOGIT..column::OPACITY_LOGIT + 1;
        for range in [column::MEAN, column::LOG_SCALE, column::QUAT, opacity, harmonics] {
            let pick = |rows: &[Vec<f64>]| {
                rows.iter().flat_map(|r| r[range.clone()].to_vec()).collect::<Vec<_>>()
            };
            let (a, b) = (pick(&found), pick(&expected));
            let size = b.iter().map(|v| v.abs()).sum::<f64>() / b.len() as f64;
            assert!(size > 0.0, "{range:?} has a gradient");
            assert!(relative_l2(&a, &b) <= 1e-3, "{degree} {range:?}: {}", relative_l2(&a, &b));
            assert!(cosine(&a, &b) >= 0.9999);
            let outliers =
                a.iter().zip(&b).filter(|(x, y)| (*x - *y).abs() > 1e-3 * (size + y.abs())).count();
            assert!(
                outliers as f64 <= 0.005 * a.len() as f64,
                "{degree} {range:?}: {outliers} of {}",
                a.len()
            );
            let bias: f64 = a.iter().zip(&b).map(|(x, y)| x - y).sum::<f64>() / b.len() as f64;
            assert!(bias.abs() <= 1e-3 * size, "{range:?}: bias {bias}, size {size}");
        }
    }
}

#[test]
fn the_first_update_and_its_moments_match_scalar_adam() {
    let bench = Bench::new(fixtures::gaussians(60, 1, 9), 1);
    let gradients = bench.gradients();
    bench.optimizer.geometry_moments.clear().expect("cleared");
    bench.optimizer.sh_moments.clear().expect("cleared");
    let start = bench.device.download().expect("read");
    let first = StepUniform::new(&SCHEDULE, 0, 60, 2.0, false);
    bench.step(&PROJECT_BACKWARD_ADAM, first);
    let moved = bench.device.download().expect("read");
    let rate = |n: usize| match n {
        n if column::MEAN.contains(&n) => first.rates[0],
        n if column::LOG_SCALE.contains(&n) => first.rates[1],
        n if column::QUAT.contains(&n) => first.rates[2],
        column::OPACITY_LOGIT => first.rates[3],
        n if n < column::HARMONICS + 3 => first.rate_sh0,
        _ => first.rate_sh,
    };
    for (i, row) in gradients.iter().enumerate() {
        let (before, after) = (
            Splat::from_gaussians(&start, i).flatten(),
            Splat::from_gaussians(&moved, i).flatten(),
        );
        for n in 0..before.len() {
            // The first step of Adam moves every parameter by its rate against the gradient's sign.
            let g = row[n];
            let expected = before[n] - f64::from(rate(n)) * if g == 0.0 { 0.0 } else { g.signum() };
            assert!(
                (after[n] - expected).abs() <= 2e-6 * (1.0 + expected.abs()),
                "{i} {n}: {} {expected}",
                after[n]
            );
        }
    }
    let moments = bench.optimizer.read_geometry_moments(60).expect("read");
    for (moments, row) in moments.iter().zip(&gradients) {
        for ((first, second), g) in moments.first.iter().zip(&moments.second).zip(row) {
            let (first, second) = (f64::from(*first), f64::from(*second));
            assert!((first - 0.1 * g).abs() <= 1e-6 + 1e-5 * g.abs());
            assert!((second - 0.001 * g * g).abs() <= 1e-6 + 1e-5 * g * g);
        }
    }
}

#[test]
fn non_finite_gradients_are_dropped_and_counted() {
    let bench = Bench::new(fixtures::gaussians(50, 1, 9), 1);
    let spans = bench.projection.spans.read().expect("read");
    let visible: Vec<_> = (0..50).filter(|&i| spans[1 + i][1] > 0).collect();
    let first = |n: usize| spans[1 + visible[n]][0] as usize;
    bench.rows.moments.write_at(first(0), &[[f32::NAN, 0.0, 0.0, 0.0]]).expect("written");
    bench.rows.colours.write_at(first(3), &[[0.0, 0.0, f32::INFINITY, 0.0]]).expect("written");
    bench.rows.colours.write_at(first(5), &[[0.0, 0.0, 0.0, 1e30]]).expect("written");
    let before = bench.device.download().expect("read");
    bench.step(&PROJECT_BACKWARD_ADAM, StepUniform::new(&SCHEDULE, 0, 50, 1.0, true));
    let after = bench.device.download().expect("read");
    assert_eq!(bench.projection.dropped().expect("read"), 3);
    for &i in &[visible[0], visible[3], visible[5]] {
        assert_eq!(before.means[i], after.means[i]);
    }
    assert_ne!(before.means[visible[1]], after.means[visible[1]]);
    let moments = bench.optimizer.geometry_moments.read(bench.gaussians.len()).expect("read");
    assert!(
        moments
            .iter()
            .chain(&bench.optimizer.sh_moments.read(bench.gaussians.len()).expect("read"))
            .all(|v| v.is_finite())
    );
}

#[test]
fn a_step_whose_slots_overflowed_changes_nothing() {
    let bench = Bench::new(fixtures::gaussians(50, 1, 9), 1);
    bench.projection.spans.write(&[[bench.slots + 1, 0]]).expect("written");
    bench.step(&PROJECT_BACKWARD_ADAM, StepUniform::new(&SCHEDULE, 0, 50, 1.0, true));
    assert_eq!(bench.device.download().expect("read"), bench.gaussians);
    assert!(
        bench
            .optimizer
            .geometry_moments
            .read(bench.gaussians.len())
            .expect("read")
            .iter()
            .all(|v| *v == 0.0)
    );
}

#[test]
fn exploration_moves_faint_gaussians_and_leaves_opaque_ones() {
    let mut gaussians = fixtures::gaussians(400, 0, 9);
    gaussians.means.iter_mut().for_each(|m| m[2] -= 500.0);
    gaussians.log_scales.fill([-1.0, -1.0, -4.0]);
    gaussians.quats.fill([1.0, 0.0, 0.0, 0.0]);
    for i in 0..400 {
        gaussians.opacity_logits[i] = if i < 200 { -9.0 } else { 2.0 };
    }
    let bench = Bench::new(gaussians, 0);
    let noise = StepUniform {
        noise: 1.0,
        seed: 3,
        step: 7,
        bias_m: 1.0,
        bias_v: 1.0,
        ..StepUniform::default()
    };
    bench.step(&PROJECT_BACKWARD_ADAM, noise);
    let after = bench.device.download().expect("read");
    let moved =
        |i: usize, axis: usize| f64::from(after.means[i][axis] - bench.gaussians.means[i][axis]);
    let spread =
        |axis: usize| ((0..200).map(|i| moved(i, axis).powi(2)).sum::<f64>() / 200.0).sqrt();
    // Covariance e^-2 along x and y; the gate at opacity 0.0001 is sigmoid(0.488) = 0.62.
    assert!((spread(0) / 0.0838 - 1.0).abs() < 0.2 && (spread(1) / 0.0838 - 1.0).abs() < 0.2);
    assert!(spread(2) < 0.01);
    assert!((200..400).all(|i| moved(i, 0).abs() < 1e-6));
}

#[test]
fn no_gaussian_recedes_by_more_than_a_quarter_of_its_depth() {
    let mut gaussians = fixtures::gaussians(60, 0, 9);
    gaussians.log_scales[..30].fill([2.0, -1.0, 2.0]);
    gaussians.quats[..30].fill([1.0, 0.0, 0.0, 0.0]);
    let bench = Bench::new(gaussians, 0);
    bench.step(&PROJECT_BACKWARD_ADAM, StepUniform::default());
    let seen = bench.projection.tile_counts(60).expect("read");
    let (after, camera) = (bench.device.download().expect("read"), &bench.view.camera);
    let mut shrunk = [0; 3];
    for i in (0..30).filter(|&i| seen[i] > 0) {
        let mean = DVec3::from(bench.gaussians.means[i].map(f64::from));
        let depth = (camera.rotation() * mean + camera.translation()).z;
        for (axis, shrunk) in shrunk.iter_mut().enumerate() {
            let recedes = camera.rotation().col(axis).z.abs();
            let (before, after) = (bench.gaussians.log_scales[i][axis], after.log_scales[i][axis]);
            let expected = before.min((0.25 * depth / recedes.max(1e-6)).ln() as f32);
            assert!((after - expected).abs() < 1e-4, "{i} {axis}: {after} {expected}");
            *shrunk += usize::from(after < before);
        }
    }
    assert!(shrunk[2] > 5 && shrunk[0] < shrunk[2], "{shrunk:?}");
    assert!(
        (30..60)
            .filter(|&i| seen[i] == 0)
            .all(|i| after.log_scales[i] == bench.gaussians.log_scales[i])
    );
}

#[test]
fn the_step_uniform_has_the_shaders_layout() {
    let (_, found) = PROJECT_BACKWARD_ADAM.reflect().expect("valid");
    let step = found.structure("StepUniform").expect("declared");
    assert_eq!(step.size as usize, size_of::<StepUniform>());
    let offset = |name: &str| step.members.iter().find(|m| m.0 == name).map(|m| m.1 as usize);
    assert_eq!(offset("rate_sh0"), Some(std::mem::offset_of!(StepUniform, rate_sh0)));
    assert_eq!(offset("opacity_weight"), Some(std::mem::offset_of!(StepUniform, opacity_weight)));
    assert_eq!(offset("noise"), Some(std::mem::offset_of!(StepUniform, noise)));
    assert_eq!(offset("capacity"), Some(std::mem::offset_of!(StepUniform, capacity)));
    let (beta_m, beta_v) = (found.constant("BETA_M"), found.constant("BETA_V"));
    assert!((beta_m.expect("declared") - BETA_M).abs() < 1e-6);
    assert!((beta_v.expect("declared") - BETA_V).abs() < 1e-6);
}
