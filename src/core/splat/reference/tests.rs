use glam::DVec3;

use super::*;
use crate::camera::{Camera, Intrinsics};

/// A small deterministic generator for tests, uniform in 0..1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn signed(&mut self) -> f64 {
        2.0 * self.next() - 1.0
    }
}

fn view() -> Viewpoint {
    let intrinsics = Intrinsics { width: 20, height: 14, fx: 18.0, fy: 17.0, cx: 9.3, cy: 7.6 };
    let camera = Camera::look_at(
        intrinsics,
        DVec3::new(0.4, -0.3, -3.0),
        DVec3::ZERO,
        DVec3::new(0.1, 1.0, 0.0),
    );
    Viewpoint { camera, sh_degree: 3, near: 0.1 }
}

fn splats(count: usize, seed: u64) -> Vec<Splat> {
    let mut random = Random(seed);
    (0..count)
        .map(|_| Splat {
            mean: [1.2 * random.signed(), 0.9 * random.signed(), 0.8 * random.signed()],
            log_scale: [0; 3].map(|_| -1.6 + 0.6 * random.signed()),
            quat: [0; 4].map(|_| random.signed()),
            opacity_logit: random.signed(),
            sh: (0..16).map(|_| [0; 3].map(|_| 0.4 * random.signed())).collect(),
        })
        .collect()
}

fn objective(splats: &[Splat], view: &Viewpoint, weights: &[f64]) -> f64 {
    render(splats, view).1.image.iter().zip(weights).map(|(a, b)| a * b).sum()
}

/// Share of values whose analytic gradient differs from the central difference. Cut-offs of alpha
/// make the image jump by at most 1/255, which breaks central differences; such outliers are
/// tolerated by counting.
fn outlier_share(analytic: &[f64], numeric: &[f64]) -> f64 {
    let scale = numeric.iter().map(|v| v.abs()).fold(0.0, f64::max);
    let off = analytic
        .iter()
        .zip(numeric)
        .filter(|(a, n)| (*a - *n).abs() > 1e-4 * scale + 1e-4 * n.abs());
    off.count() as f64 / analytic.len() as f64
}

fn numeric_gradient(splats: &[Splat], index: usize, view: &Viewpoint, weights: &[f64]) -> Vec<f64> {
    let row = splats[index].flatten();
    let step = 1e-6;
    (0..row.len())
        .map(|n| {
            let at = |delta: f64| {
                let mut moved = splats.to_vec();
                let mut changed = row.clone();
                changed[n] += delta;
                moved[index] = Splat::unflatten(&changed);
                objective(&moved, view, weights)
            };
            (at(step) - at(-step)) / (2.0 * step)
        })
        .collect()
}

#[test]
fn gradients_of_the_whole_render_match_central_differences() {
    let view = view();
    let splats = splats(8, 5);
    let mut random = Random(11);
    let weights: Vec<_> = (0..3 * 20 * 14).map(|_| random.signed()).collect();
    let analytic = render_backward(&splats, &view, &weights);
    let (mut all, mut expected) = (Vec::new(), Vec::new());
    for (index, gradient) in analytic.iter().enumerate() {
        all.extend(gradient.flatten());
        expected.extend(numeric_gradient(&splats, index, &view, &weights));
    }
    assert!(outlier_share(&all, &expected) <= 0.01, "{}", outlier_share(&all, &expected));
    let mut wrong = all.clone();
    wrong.iter_mut().for_each(|v| *v *= 1.01);
    assert!(outlier_share(&wrong, &expected) > 0.1, "the comparison must be able to fail");
}

#[test]
fn projection_gradients_match_differences_clamped_or_not() {
    let view = view();
    let mut random = Random(3);
    let mut list = splats(12, 21);
    // Far outside the field of view, where the slope is clamped, and large enough to reach into it.
    for splat in list.iter_mut().take(4) {
        splat.mean = [5.0, 0.2, 0.1];
        splat.log_scale = [0; 3].map(|_| 1.0 + 0.2 * random.signed());
        splat.opacity_logit = 2.0;
    }
    for splat in &list {
        let upstream = ProjectedGradient {
            mean: [random.signed(), random.signed()],
            conic: [0; 3].map(|_| random.signed()),
            colour: [0; 3].map(|_| random.signed()),
            opacity: random.signed(),
        };
        let value = |s: &Splat| {
            let p = project(s, &view).expect("visible");
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            dot(&p.mean, &upstream.mean)
                + dot(&p.conic, &upstream.conic)
                + dot(&p.colour, &upstream.colour)
                + p.opacity * upstream.opacity
        };
        if project(splat, &view).is_none() {
            continue;
        }
        let analytic = project_backward(splat, &view, &upstream).flatten();
        let row = splat.flatten();
        for (n, gradient) in analytic.iter().enumerate() {
            let at = |delta: f64| {
                let mut changed = row.clone();
                changed[n] += delta;
                value(&Splat::unflatten(&changed))
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!(
                (gradient - numeric).abs() <= 1e-5 * (1.0 + numeric.abs()),
                "{n}: {gradient} {numeric}"
            );
        }
    }
}

#[test]
fn harmonics_are_orthonormal_over_the_sphere() {
    let mut random = Random(9);
    let mut sums = [[0.0; 16]; 16];
    let samples = 40_000;
    for _ in 0..samples {
        let z = random.signed();
        let angle = std::f64::consts::TAU * random.next();
        let r = (1.0 - z * z).sqrt();
        let values = harmonics::basis([r * angle.cos(), r * angle.sin(), z]);
        for i in 0..16 {
            for j in 0..16 {
                sums[i][j] +=
                    values[i] * values[j] * 4.0 * std::f64::consts::PI / f64::from(samples);
            }
        }
    }
    for (i, row) in sums.iter().enumerate() {
        for (j, sum) in row.iter().enumerate() {
            assert!((sum - f64::from(u8::from(i == j))).abs() < 0.06, "{i} {j}: {sum}");
        }
    }
}

#[test]
fn splats_behind_the_camera_and_poisoned_ones_are_culled() {
    let view = view();
    let good = &splats(1, 5)[0];
    let mut list = vec![good.clone(); 5];
    list[0].mean = [0.4, -0.3, -4.0];
    list[1].mean[1] = f64::NAN;
    list[2].quat = [0.0; 4];
    list[3].opacity_logit = -9.0;
    list[4].log_scale = [f64::INFINITY; 3];
    assert!(project(good, &view).is_some());
    assert!(list.iter().all(|splat| project(splat, &view).is_none()));
    let (_, blended) = render(&list, &view);
    assert!(blended.image.iter().all(|v| *v == 0.0));
    assert!(blended.transmittance.iter().all(|t| *t == 1.0));
}
