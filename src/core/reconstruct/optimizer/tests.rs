use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::*;
use crate::gaussians::Gaussians;
use crate::reconstruct::densify;
use crate::splat::fixtures::{self, Random, cosine, relative_l2};
use crate::splat::project::sh_row;
use crate::splat::rasterize::{SLOT_ROW, gradient};
use crate::splat::reference::{ProjectedGradient, Splat, Viewpoint, project, project_backward};
use crate::splat::uniform::CameraUniform;

const SCHEDULE: Schedule = Schedule {
    steps: 1_000,
    sh_degree: 3,
    resolution: false,
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
    offsets: Buffer<u32>,
    rows: SlotRows,
    totals: Buffer<u32>,
    upstream: Vec<ProjectedGradient>,
    slots: u32,
}

impl Bench {
    fn new(gaussians: Gaussians, degree: u32) -> Self {
        let gpu = fixtures::gpu();
        let view = Viewpoint {
            sh_degree: degree,
            ..fixtures::viewpoint(144, 96)
        };
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
        let counts = projection.tile_counts.read().expect("read");
        let (mut offsets, mut rows, mut upstream) = (Vec::new(), Vec::new(), Vec::new());
        let mut random = Random::new(77);
        for &count in &counts {
            offsets.push(rows.len() as u32);
            let mut sum = [0.0; SLOT_ROW];
            for _ in 0..count {
                let row = [0; SLOT_ROW].map(|_| random.signed() as f32);
                sum.iter_mut()
                    .zip(row)
                    .for_each(|(s, v)| *s += f64::from(v));
                rows.push(row);
            }
            let splat = project(&Splat::from_gaussians(&gaussians, upstream.len()), &view);
            upstream.push(splat.map_or_else(ProjectedGradient::default, |p| {
                gradient(&sum, p.conic, p.opacity)
            }));
        }
        let slots = rows.len() as u32;
        let uploaded = SlotRows::new(gpu, slots as usize).expect("created");
        uploaded.write(&rows).expect("written");
        Self {
            optimizer: Optimizer::new(gpu, &device, false).expect("created"),
            offsets: gpu.upload("offsets", &offsets).expect("uploaded"),
            totals: gpu.upload("totals", &[0, slots]).expect("uploaded"),
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
        let uniform = StepUniform {
            total_at: 1,
            capacity: self.slots,
            ..uniform
        };
        self.optimizer.step.write(&[uniform]).expect("written");
        let slots = SlotGradients {
            slot_offsets: &self.offsets,
            rows: &self.rows,
            totals: &self.totals,
        };
        let mut recorder = fixtures::gpu().recorder();
        let optimizer = &self.optimizer;
        optimizer
            .record_as(
                kernel,
                &mut recorder,
                &self.device,
                &self.projection,
                &slots,
            )
            .expect("recorded");
        recorder.submit().expect("submitted");
    }

    /// The kernel's gradients: mean, log-scale, quaternion, logit, harmonics, by Gaussian.
    fn gradients(&self) -> Vec<Vec<f64>> {
        self.step(
            &PROJECT_BACKWARD_ADAM.with(&[("WRITE_GRADIENTS", 1)]),
            StepUniform::default(),
        );
        let count = self.gaussians.len();
        let geometry = self.optimizer.geometry_moments.read(count).expect("read");
        let sh = self.optimizer.sh_moments.read(count).expect("read");
        let (row, stride) = (
            3 * self.gaussians.coefficients(),
            2 * sh_row(self.gaussians.sh_degree),
        );
        (0..self.gaussians.len())
            .map(|i| {
                let head = geometry[24 * i..24 * i + 11].iter();
                head.chain(&sh[stride * i..stride * i + row])
                    .map(|v| f64::from(*v))
                    .collect()
            })
            .collect()
    }
}

#[test]
fn gradients_of_every_parameter_equal_the_reference() {
    for degree in [0, 2, 3] {
        let bench = Bench::new(fixtures::gaussians(300, 3, 4), degree);
        let found = bench.gradients();
        let expected: Vec<_> = (0..300)
            .map(|i| {
                let splat = Splat::from_gaussians(&bench.gaussians, i);
                project_backward(&splat, &bench.view, &bench.upstream[i]).flatten()
            })
            .collect();
        for range in [0..3, 3..6, 6..10, 10..11, 11..59] {
            let pick = |rows: &[Vec<f64>]| {
                rows.iter()
                    .flat_map(|r| r[range.clone()].to_vec())
                    .collect::<Vec<_>>()
            };
            let (a, b) = (pick(&found), pick(&expected));
            let size = b.iter().map(|v| v.abs()).sum::<f64>() / b.len() as f64;
            assert!(size > 0.0, "{range:?} has a gradient");
            assert!(
                relative_l2(&a, &b) <= 1e-3,
                "{degree} {range:?}: {}",
                relative_l2(&a, &b)
            );
            assert!(cosine(&a, &b) >= 0.9999);
            let outliers = a
                .iter()
                .zip(&b)
                .filter(|(x, y)| (*x - *y).abs() > 1e-3 * (size + y.abs()))
                .count();
            assert!(
                outliers as f64 <= 0.005 * a.len() as f64,
                "{degree} {range:?}: {outliers} of {}",
                a.len()
            );
            let bias: f64 = a.iter().zip(&b).map(|(x, y)| x - y).sum::<f64>() / b.len() as f64;
            assert!(
                bias.abs() <= 1e-3 * size,
                "{range:?}: bias {bias}, size {size}"
            );
        }
    }
}

#[test]
fn opacities_that_make_up_for_dropped_gaussians_have_the_gradient_of_that() {
    let bench = Bench::new(fixtures::gaussians(100, 1, 4), 1);
    let whole = bench.gradients();
    let camera = bench.projection.camera.read().expect("read")[0];
    bench
        .projection
        .camera
        .write(&[camera.dropping(0.2, 7)])
        .expect("written");
    // The same gradient by an opacity that is a quarter larger: v is that opacity times the
    // gradient by it.
    let mut colours = bench.rows.colours.read().expect("read");
    colours.iter_mut().for_each(|row| row[3] *= 1.25);
    bench.rows.colours.write(&colours).expect("written");
    for (dropping, whole) in bench.gradients().iter().zip(&whole) {
        for (n, (a, b)) in dropping.iter().zip(whole).enumerate() {
            let factor = if n == 10 { 1.25 } else { 1.0 };
            assert!(
                (a - factor * b).abs() <= 1e-6 + 1e-5 * b.abs(),
                "{n}: {a} {b}"
            );
        }
    }
}

#[test]
fn the_first_update_and_its_moments_equal_scalar_adam() {
    let bench = Bench::new(fixtures::gaussians(60, 1, 9), 1);
    let gradients = bench.gradients();
    bench.optimizer.geometry_moments.clear().expect("cleared");
    bench.optimizer.sh_moments.clear().expect("cleared");
    let start = bench.device.download().expect("read");
    let first = StepUniform::new(&SCHEDULE, 0, 60, 2.0, false);
    bench.step(&PROJECT_BACKWARD_ADAM, first);
    let moved = bench.device.download().expect("read");
    let rate = |n: usize| match n {
        0..3 => first.rates[0],
        3..6 => first.rates[1],
        6..10 => first.rates[2],
        10 => first.rates[3],
        11..14 => first.rate_sh0,
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
    let moments = bench
        .optimizer
        .geometry_moments
        .read(bench.gaussians.len())
        .expect("read");
    for (i, row) in gradients.iter().enumerate() {
        for (n, g) in row[..11].iter().enumerate() {
            assert!((f64::from(moments[24 * i + n]) - 0.1 * g).abs() <= 1e-6 + 1e-5 * g.abs());
            assert!(
                (f64::from(moments[24 * i + 12 + n]) - 0.001 * g * g).abs() <= 1e-6 + 1e-5 * g * g
            );
        }
    }
}

#[test]
fn non_finite_gradients_are_dropped_and_counted() {
    let bench = Bench::new(fixtures::gaussians(50, 1, 9), 1);
    let counts = bench.projection.tile_counts.read().expect("read");
    let visible: Vec<_> = (0..50).filter(|&i| counts[i] > 0).collect();
    let offsets = bench.offsets.read().expect("read");
    let first = |n: usize| offsets[visible[n]] as usize;
    bench
        .rows
        .moments
        .write_at(first(0), &[[f32::NAN, 0.0, 0.0, 0.0]])
        .expect("written");
    bench
        .rows
        .colours
        .write_at(first(3), &[[0.0, 0.0, f32::INFINITY, 0.0]])
        .expect("written");
    bench
        .rows
        .colours
        .write_at(first(5), &[[0.0, 0.0, 0.0, 1e30]])
        .expect("written");
    let before = bench.device.download().expect("read");
    bench.step(
        &PROJECT_BACKWARD_ADAM,
        StepUniform::new(&SCHEDULE, 0, 50, 1.0, true),
    );
    let after = bench.device.download().expect("read");
    assert_eq!(bench.optimizer.counters.read().expect("read")[0], 3);
    for &i in &[visible[0], visible[3], visible[5]] {
        assert_eq!(before.means[i], after.means[i]);
    }
    assert_ne!(before.means[visible[1]], after.means[visible[1]]);
    let moments = bench
        .optimizer
        .geometry_moments
        .read(bench.gaussians.len())
        .expect("read");
    assert!(
        moments
            .iter()
            .chain(
                &bench
                    .optimizer
                    .sh_moments
                    .read(bench.gaussians.len())
                    .expect("read")
            )
            .all(|v| v.is_finite())
    );
}

#[test]
fn a_step_whose_slots_overflowed_changes_nothing() {
    let bench = Bench::new(fixtures::gaussians(50, 1, 9), 1);
    bench.totals.write(&[0, bench.slots + 1]).expect("written");
    bench.step(
        &PROJECT_BACKWARD_ADAM,
        StepUniform::new(&SCHEDULE, 0, 50, 1.0, true),
    );
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
    // covariance e^-2 along x and y; the gate at opacity 0.0001 is sigmoid(0.488) = 0.62.
    assert!((spread(0) / 0.0838 - 1.0).abs() < 0.2 && (spread(1) / 0.0838 - 1.0).abs() < 0.2);
    assert!(spread(2) < 0.01);
    assert!((200..400).all(|i| moved(i, 0).abs() < 1e-6));
}

#[test]
fn relocation_copies_splits_and_clears_on_the_device() {
    relocates(fixtures::gpu(), 1);
    // Six parts of four, and moves in chunks of six: from part to part.
    relocates(&Gpu::binding_at_most("auto", 1_024).expect("an adapter"), 6);
}

fn relocates(gpu: &Gpu, parts: usize) {
    let mut gaussians = fixtures::gaussians(20, 2, 9);
    gaussians.opacity_logits[4] = -8.0;
    let mut device = DeviceGaussians::upload(gpu, &gaussians, 24).expect("uploaded");
    assert_eq!(device.parts.len(), parts);
    let optimizer = Optimizer::new(gpu, &device, false).expect("created");
    optimizer
        .geometry_moments
        .write(&vec![1.0; 24 * 24])
        .expect("written");
    optimizer
        .sh_moments
        .write(&vec![1.0; 24 * 56])
        .expect("written");
    let rows = crate::splat::project::pack_geometry(&gaussians);
    let plan = densify::plan(&rows, 22, &mut Pcg64::seed_from_u64(3));
    optimizer.relocate(gpu, &device, &plan).expect("relocated");
    device.count = plan.count;
    let after = device.download().expect("read");
    let (geometry, sh) = (
        optimizer.geometry_moments.read(24),
        optimizer.sh_moments.read(24),
    );
    let (geometry, sh) = (geometry.expect("read"), sh.expect("read"));
    assert_eq!(after.len(), 22);
    let touched: Vec<_> = plan.moves.iter().map(|m| m[0] as usize).collect();
    assert!(touched.contains(&4) && touched.contains(&20) && touched.contains(&21));
    for (&[to, from], shape) in plan.moves.iter().zip(&plan.shapes) {
        let (to, from) = (to as usize, from as usize);
        assert_eq!(after.means[to], gaussians.means[from]);
        assert_eq!(after.quats[to], gaussians.quats[from]);
        assert_eq!(after.log_scales[to], shape[..3]);
        assert_eq!(after.opacity_logits[to], shape[3]);
        assert_eq!(
            after.sh[27 * to..27 * to + 27],
            gaussians.sh[27 * from..27 * from + 27]
        );
    }
    for i in 0..20 {
        let expected = if touched.contains(&i) { 0.0 } else { 1.0 };
        assert!(
            geometry[24 * i..24 * i + 24].iter().all(|v| *v == expected),
            "{i}"
        );
        assert!(
            sh[56 * i..56 * i + 56].iter().all(|v| *v == expected),
            "{i}"
        );
    }
}

#[test]
fn the_step_has_the_layout_of_the_shader() {
    let (_, found) = PROJECT_BACKWARD_ADAM.reflect().expect("valid");
    let step = found.structure("StepUniform").expect("declared");
    assert_eq!(step.size as usize, size_of::<StepUniform>());
    let offset = |name: &str| {
        step.members
            .iter()
            .find(|m| m.0 == name)
            .map(|m| m.1 as usize)
    };
    assert_eq!(
        offset("rate_sh0"),
        Some(std::mem::offset_of!(StepUniform, rate_sh0))
    );
    assert_eq!(
        offset("opacity_weight"),
        Some(std::mem::offset_of!(StepUniform, opacity_weight))
    );
    assert_eq!(
        offset("noise"),
        Some(std::mem::offset_of!(StepUniform, noise))
    );
    assert_eq!(
        offset("total_at"),
        Some(std::mem::offset_of!(StepUniform, total_at))
    );
    let (beta_m, beta_v) = (found.constant("BETA_M"), found.constant("BETA_V"));
    assert!((beta_m.expect("declared") - BETA_M).abs() < 1e-6);
    assert!((beta_v.expect("declared") - BETA_V).abs() < 1e-6);
}
