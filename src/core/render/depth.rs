//! The depth of a scene, by the renderer of its colours. Each Gaussian is drawn with its depth as
//! red and a constant green, so a pixel's red over its green is the mean depth there, weighted like
//! its colour.

use glam::DVec3;

use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::image::Image;

/// Least share of stopped light in a pixel with a depth.
const LEAST_STOPPED: f32 = 0.5;
/// Share of the pixels that may be nearer than white or farther than [`DARKEST`].
const BEYOND: f64 = 0.02;
/// Brightness of the farthest depth; black means no depth.
const DARKEST: f32 = 0.1;

/// The depths that a camera sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    width: usize,
    height: usize,
    /// [height, width], world units along the camera's axis; `None` where too little light is
    /// stopped.
    values: Vec<Option<f32>>,
}

/// Depth of a Gaussian's mean, world units along the camera's axis.
fn depth(mean: [f32; 3], camera: &Camera) -> f64 {
    let mean = DVec3::from(mean.map(f64::from));
    camera.world_to_camera.transform_point3(mean).z
}

/// Approximate depth of the scene, world units: the drawn values should be about 1.
pub(super) fn unit(gaussians: &Gaussians, camera: &Camera) -> f64 {
    let depths = gaussians.means.iter().map(|&mean| depth(mean, camera));
    let mut before: Vec<f64> = depths.filter(|&z| z > 0.0 && z.is_finite()).collect();
    let middle = before.len() / 2;
    if before.is_empty() {
        return 1.0;
    }
    *before.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The scene coloured by its depth.
pub(super) fn as_colours(gaussians: &Gaussians, camera: &Camera, unit: f64) -> Gaussians {
    gaussians.coloured(|i| {
        let far = depth(gaussians.means[i], camera) / unit;
        [far as f32, 1.0, 0.0]
    })
}

impl Depth {
    /// Decodes the render of [`as_colours`].
    pub(super) fn of(render: &Image, unit: f64) -> Self {
        let value = |(far, stopped): (&f32, &f32)| {
            let is_seen = *stopped >= LEAST_STOPPED;
            is_seen.then(|| (f64::from(far / stopped) * unit) as f32)
        };
        Self {
            width: render.width(),
            height: render.height(),
            values: render.plane(0).iter().zip(render.plane(1)).map(value).collect(),
        }
    }

    /// World units along the camera's axis; `None` where too little light is stopped.
    ///
    /// # Panics
    /// When the pixel is outside the image: a fault of the caller.
    pub fn at(&self, x: usize, y: usize) -> Option<f32> {
        assert!(x < self.width && y < self.height, "{x}, {y} of a depth");
        self.values[y * self.width + x]
    }

    /// All depths, row by row; `None` where too little light is stopped.
    pub fn values(&self) -> &[Option<f32>] {
        &self.values
    }

    /// A picture for people: grey by inverse depth, near white and far dark, black without a depth.
    pub fn picture(&self) -> Image {
        let near = |depth: f32| 1.0 / depth.max(f32::MIN_POSITIVE);
        let mut all: Vec<f32> = self.values.iter().flatten().map(|&z| near(z)).collect();
        all.sort_by(f32::total_cmp);
        let last = all.len().saturating_sub(1) as f64;
        let at = |share: f64| all.get((share * last).round() as usize).copied();
        let (low, high) = (at(BEYOND).unwrap_or(0.0), at(1.0 - BEYOND).unwrap_or(1.0));
        let grey = |depth: f32| {
            let share = (near(depth) - low) / (high - low).max(f32::MIN_POSITIVE);
            DARKEST + (1.0 - DARKEST) * share.clamp(0.0, 1.0)
        };
        let shades = self.values.iter().map(|depth| depth.map_or(0.0, grey));
        let plane: Vec<f32> = shades.collect();
        Image::from_planar(self.width, self.height, plane.repeat(3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::device::Device;
    use crate::render::Renderer;

    const SIDE: usize = 64;

    /// A camera at the origin that looks along z, and two opaque walls of many small Gaussians: one
    /// at depth 2 on the left, one at 6 on the right, with an empty band between them.
    fn walls() -> (Gaussians, Camera) {
        let side = SIDE as f64;
        let intrinsics = Intrinsics {
            width: SIDE,
            height: SIDE,
            fx: side,
            fy: side,
            cx: side / 2.0,
            cy: side / 2.0,
        };
        let camera = Camera::look_at(intrinsics, DVec3::ZERO, DVec3::Z, DVec3::Y);
        let mut scene = Gaussians::default();
        for (left, right, far) in [(-0.6, -0.1, 2.0), (0.1, 0.6, 6.0)] {
            for column in 0..40 {
                for row in 0..60 {
                    let x = left + (right - left) * f64::from(column) / 39.0;
                    let y = -0.6 + 1.2 * f64::from(row) / 59.0;
                    scene.means.push([x * far, y * far, far].map(|v| v as f32));
                    scene.quats.push([1.0, 0.0, 0.0, 0.0]);
                    scene.log_scales.push([(0.015 * far).ln() as f32; 3]);
                    scene.opacity_logits.push(4.0);
                    scene.sh.extend([0.3, -0.4, 1.0]);
                }
            }
        }
        (scene, camera)
    }

    #[test]
    fn depth_is_that_of_the_visible_surface_or_none() {
        let (scene, camera) = walls();
        let renderer = Renderer::new(&Device::Processor);
        let depth = renderer.depth(&scene, &camera).expect("rendered");
        let (near, far) = (depth.at(12, 32), depth.at(52, 32));
        let is_near = |found: Option<f32>, wanted: f32| {
            found.is_some_and(|z| (z - wanted).abs() < 0.02 * wanted)
        };
        assert!(is_near(near, 2.0), "{near:?}");
        assert!(is_near(far, 6.0), "{far:?}");
        assert_eq!(depth.at(32, 32), None);
        let picture = depth.picture();
        let [white, dark, black] = [12, 52, 32].map(|x| picture.get(x, 32)[0]);
        assert!(white > 0.9 && (DARKEST..0.2).contains(&dark), "{white} {dark}");
        assert_eq!(black, 0.0);
    }

    #[test]
    fn a_scene_behind_the_camera_has_no_depth() {
        let (mut scene, camera) = walls();
        scene.means.iter_mut().for_each(|mean| mean[2] *= -1.0);
        let renderer = Renderer::new(&Device::Processor);
        let depth = renderer.depth(&scene, &camera).expect("rendered");
        assert_eq!(depth.at(12, 32), None);
        assert!(depth.picture().data().iter().all(|&v| v == 0.0));
    }
}
