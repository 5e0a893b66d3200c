//! Scenes to measure: a synthetic one from a seed, the same on every machine, or that of a finished
//! run.

use std::path::Path;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::error::BenchError;
use fled_core::camera::{Camera, Intrinsics, NamedCamera, Split};
use fled_core::device::Device;
use fled_core::gaussians::Gaussians;
use fled_core::gaussians::ply::{self, Scene};
use fled_core::image::{Image, Linear};
use fled_core::reconstruct::{Point, TrainingView, scene_extent};
use fled_core::render::Renderer;

/// Degree of the harmonics in synthetic scenes: the paper's.
const SH_DEGREE: u32 = 3;
/// Number of views in a synthetic scene: more would cost memory and change nothing.
const VIEWS: usize = 3;
/// Half the sides of the box around the Gaussians, world units; the cameras are 3 in front of its
/// middle.
const BOX: [f64; 3] = [1.6, 0.95, 1.0];
/// Median scale of a Gaussian among 10,000, world units, chosen so that they touch 3.5 tiles each
/// at 280x160, as in trained scenes (31,000 to 46,000 intersections of 10,000 Gaussians).
const SCALE: f64 = 0.024;
/// Length of the shake of a shaken view, as a share of its width: 5 px at 280.
const SHAKEN: f64 = 0.018;

/// A scene with its training views.
pub struct Workload {
    /// Name shown to users.
    pub name: String,
    /// Training views.
    pub views: Vec<TrainingView>,
    /// The scene.
    pub gaussians: Gaussians,
    /// [`scene_extent`], world units.
    pub extent: f64,
}

impl Workload {
    /// `gaussians` random Gaussians in a box in front of three cameras of `size` px. The more there
    /// are, the smaller they are, as in trained scenes. The views are renders of the scene itself,
    /// so training hardly changes it.
    ///
    /// # Errors
    /// Rendering failed, typically out of memory.
    pub fn synthetic(
        device: &Device,
        size: (usize, usize),
        gaussians: usize,
        seed: u64,
    ) -> Result<Self, BenchError> {
        let scene = random_scene(gaussians, seed);
        let renderer = Renderer::new(device);
        let uploaded = renderer.upload(&scene)?;
        let view = |index: usize| -> Result<TrainingView, BenchError> {
            let camera = camera(index, size);
            let image = renderer.render_scene(&uploaded, &camera)?;
            Ok(TrainingView {
                noise: None,
                has_kernel: true,
                name: index.to_string(),
                camera,
                image,
                mask: None,
            })
        };
        let views = (0..VIEWS).map(view).collect::<Result<_, _>>()?;
        Ok(Self::new(format!("{}x{}, {gaussians} Gaussians", size.0, size.1), views, scene))
    }

    /// The delivered scene of a finished run, with its restored views.
    ///
    /// # Errors
    /// [`BenchError::Run`] when `folder` does not hold a finished run; files that cannot be read.
    pub fn of_run(folder: &Path) -> Result<Self, BenchError> {
        let path = folder.join("cameras.json");
        let fault =
            |error: &dyn std::fmt::Display| BenchError::Run(format!("{}: {error}", path.display()));
        let text = std::fs::read(&path).map_err(|e| fault(&e))?;
        let cameras: Vec<NamedCamera> = serde_json::from_slice(&text).map_err(|e| fault(&e))?;
        let Scene { gaussians, normalisation } = ply::read(&folder.join("scene.ply"))?;
        let view = |named: &NamedCamera| -> Result<TrainingView, BenchError> {
            let k = &named.intrinsics;
            let file = folder.join("restored").join(format!("{}.png", named.name));
            let image = Image::load(&file)?.resize_area(k.width, k.height);
            Ok(TrainingView {
                noise: None,
                has_kernel: true,
                name: named.name.clone(),
                camera: normalisation.within(&named.camera()),
                image,
                mask: None,
            })
        };
        let trained = cameras.iter().filter(|named| named.split == Split::Train);
        let views = trained.map(view).collect::<Result<Vec<_>, _>>()?;
        if views.is_empty() {
            return Err(fault(&"no training view"));
        }
        Ok(Self::new(
            format!("the capture's scene, {} Gaussians", gaussians.len()),
            views,
            gaussians,
        ))
    }

    /// Shakes every view along a line of its own, so that there is a shake to estimate.
    pub fn shake(&mut self) {
        for (index, view) in self.views.iter_mut().enumerate() {
            let angle = 1.0 + 2.0 * index as f64;
            view.image = shaken(&view.image, angle);
        }
    }

    fn new(name: String, views: Vec<TrainingView>, gaussians: Gaussians) -> Self {
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
        let points: Vec<Point> =
            gaussians.means.iter().map(|&position| Point { position, colour: [0; 3] }).collect();
        let extent = scene_extent(&cameras, &points);
        Self { name, views, gaussians, extent }
    }

    /// The camera of the first view.
    pub(super) fn camera(&self) -> Result<Camera, BenchError> {
        self.views.first().map(|view| view.camera).ok_or(BenchError::Empty("view"))
    }
}

/// The mean of the light along a line with a length of [`SHAKEN`] times the width.
fn shaken(image: &Image, angle: f64) -> Image {
    let (width, height) = (image.width(), image.height());
    let light = image.to_linear();
    let half = (0.5 * SHAKEN * width as f64).ceil() as i32;
    let taps = 2 * half + 1;
    let mut sum = Image::<Linear>::new(width, height);
    for tap in -half..=half {
        let [dx, dy] =
            [angle.cos(), angle.sin()].map(|part| (f64::from(tap) * part).round() as isize);
        for y in 0..height {
            let from_y = y.saturating_add_signed(dy).min(height - 1);
            for x in 0..width {
                let from = light.get(x.saturating_add_signed(dx).min(width - 1), from_y);
                let here = sum.get(x, y);
                sum.set(x, y, std::array::from_fn(|c| here[c] + from[c] / taps as f32));
            }
        }
    }
    sum.to_srgb()
}

/// Cameras on an arc, a sixth of a radian apart, with a focal length of the image's width.
fn camera(index: usize, (width, height): (usize, usize)) -> Camera {
    let focal = width as f64;
    let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
    let intrinsics = Intrinsics { width, height, fx: focal, fy: focal, cx, cy };
    let angle = (index as f64 - 1.0) / 6.0;
    let eye = DVec3::new(3.0 * angle.sin(), -0.2, -3.0 * angle.cos());
    Camera::look_at(intrinsics, eye, DVec3::ZERO, DVec3::Y)
}

fn random_scene(count: usize, seed: u64) -> Gaussians {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut signed = move || 2.0 * random.random::<f64>() - 1.0;
    let log_scale = (SCALE * (10_000.0 / count.max(1) as f64).sqrt()).ln();
    let mut out = Gaussians { sh_degree: SH_DEGREE, ..Gaussians::default() };
    let row = 3 * out.coefficients();
    for _ in 0..count {
        out.means.push(BOX.map(|half| (half * signed()) as f32));
        // Flat and long Gaussians, as in trained scenes.
        out.log_scales.push([0; 3].map(|_| (log_scale + 0.8 * signed()) as f32));
        out.quats.push([0; 4].map(|_| signed() as f32));
        out.opacity_logits.push((0.5 + 2.5 * signed()) as f32);
        out.sh.extend((0..row).map(|i| if i < 3 { signed() } else { 0.1 * signed() } as f32));
    }
    out
}
