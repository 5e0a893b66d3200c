//! Shared fixtures of the splat tests: one device, random scenes, comparisons.

use std::sync::OnceLock;

use fled_gpu::Gpu;
use glam::DVec3;

use super::reference::{Projected, Viewpoint};
use crate::camera::{Camera, Intrinsics};
use crate::device::Device;
use crate::gaussians::Gaussians;

/// The one device of the test process. Panics without an adapter.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| Gpu::new("auto").expect("GPU tests need a Vulkan adapter; lavapipe will do"))
}

/// That device and the processor.
pub fn devices() -> [Device; 2] {
    [Device::Gpu(gpu().clone()), Device::Processor]
}

/// A small deterministic generator.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in -1..1.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }
}

/// A camera three units in front of the origin.
pub fn viewpoint(width: usize, height: usize) -> Viewpoint {
    let focal = width as f64;
    let (cx, cy) = (width as f64 * 0.48, height as f64 * 0.53);
    let intrinsics = Intrinsics { width, height, fx: focal, fy: focal * 0.97, cx, cy };
    let eye = DVec3::new(0.4, -0.3, -3.0);
    let camera = Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::new(0.1, 1.0, 0.0));
    Viewpoint { camera, sh_degree: 3, near: 0.1 }
}

/// `count` random Gaussians around the origin, some of them out of sight.
pub fn gaussians(count: usize, sh_degree: u32, seed: u64) -> Gaussians {
    let mut random = Random::new(seed);
    let mut out = Gaussians { sh_degree, ..Gaussians::default() };
    let row = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
    for _ in 0..count {
        out.means.push([1.8, 1.2, 1.0].map(|size| (size * random.signed()) as f32));
        out.log_scales.push([0; 3].map(|_| (-2.6 + random.signed()) as f32));
        out.quats.push([0; 4].map(|_| random.signed() as f32));
        out.opacity_logits.push((2.0 * random.signed()) as f32);
        out.sh.extend((0..row).map(|_| (0.4 * random.signed()) as f32));
    }
    out
}

/// The row of the `index`-th Gaussian in the output of a projection.
pub fn projected(rows: &[[f32; 4]], index: usize) -> Projected {
    let row = rows[3 * index..3 * index + 3].as_flattened();
    let row: [f32; 12] = row.try_into().expect("twelve numbers");
    let [x, y, a, b, c, opacity, red, green, blue, depth, right, down] = row.map(f64::from);
    Projected {
        mean: [x, y],
        conic: [a, b, c],
        opacity,
        colour: [red, green, blue],
        depth,
        extent: [right, down],
    }
}

/// |a - b| / |b|.
pub fn relative_l2(a: &[f64], b: &[f64]) -> f64 {
    let difference: f64 = a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum();
    (difference / b.iter().map(|y| y * y).sum::<f64>().max(1e-300)).sqrt()
}

/// a . b / (|a| |b|).
pub fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(p, q)| p * q).sum::<f64>();
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt().max(1e-300)
}

#[test]
fn the_comparisons_distinguish_right_from_wrong() {
    let (right, wrong) = ([1.0, -2.0, 3.0], [1.0, 2.0, 3.0]);
    assert!(relative_l2(&right, &right) == 0.0 && relative_l2(&wrong, &right) > 0.5);
    assert!(cosine(&right, &right) > 0.999_999 && cosine(&wrong, &right) < 0.5);
}
