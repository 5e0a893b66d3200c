//! Long thin Gaussians: spikes in front of sky and ground that no second view constrains.

use glam::DVec3;

use super::subject::Subject;
use fled_core::camera::Camera;

/// Minimum ratio of the longest axis to the middle one.
const ELONGATION: f32 = 10.0;
/// Minimum length in the nearest view that shows the Gaussian, px, two standard deviations to each
/// side.
const LEAST_PX: f64 = 5.0;
/// Minimum opacity of a visible Gaussian.
const LEAST_OPACITY: f32 = 0.05;

/// Number of elongated Gaussians in a scene.
pub(super) fn count(subject: &Subject) -> usize {
    let scene = &subject.gaussians;
    let cameras: Vec<Camera> = subject.training().map(|(_, camera)| camera).collect();
    let is_elongated = |&i: &usize| {
        let mut axes = scene.log_scales[i];
        axes.sort_by(f32::total_cmp);
        let opacity = 1.0 / (1.0 + (-scene.opacity_logits[i]).exp());
        if opacity < LEAST_OPACITY || axes[2] - axes[1] < ELONGATION.ln() {
            return false;
        }
        let mean = DVec3::from(scene.means[i].map(f64::from));
        let length = 4.0 * f64::from(axes[2].exp());
        let seen = cameras.iter().filter_map(|camera| per_px(camera, mean));
        let finest = seen.fold(f64::INFINITY, f64::min);
        length / finest >= LEAST_PX
    };
    (0..scene.len()).filter(is_elongated).count()
}

/// World units per pixel at a point in a camera's picture.
fn per_px(camera: &Camera, point: DVec3) -> Option<f64> {
    let (_, depth) = camera.shows(point)?;
    Some(depth / camera.intrinsics.fx)
}
