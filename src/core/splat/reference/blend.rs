//! Front-to-back alpha blending on black and its gradient.

use super::projection::{ALPHA_CUT, Projected, ProjectedGradient};

/// Upper bound of alpha; no gradient flows through the active clamp.
pub const ALPHA_MAX: f64 = 0.99;
/// Blending stops before the splat that would reduce the transmittance below this.
pub const TRANSMITTANCE_STOP: f64 = 1e-4;

/// A blended image.
#[derive(Clone, Debug, PartialEq)]
pub struct Blended {
    /// px.
    pub width: usize,
    /// px.
    pub height: usize,
    /// Planar [3, H, W].
    pub image: Vec<f64>,
    /// Remaining share of the background, [H, W].
    pub transmittance: Vec<f64>,
}

struct Hit {
    index: usize,
    alpha: f64,
    /// e^-exponent.
    weight: f64,
    offset: [f64; 2],
}

/// Indices of the visible splats by depth, ties by index.
pub fn depth_order(projected: &[Option<Projected>]) -> Vec<usize> {
    let depth = |i: usize| projected[i].as_ref().map_or(f64::INFINITY, |p| p.depth);
    let mut order: Vec<_> = (0..projected.len()).filter(|&i| projected[i].is_some()).collect();
    order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
    order
}

/// The splats that are blended at a pixel, front to back, and the final transmittance.
fn hits(projected: &[Option<Projected>], order: &[usize], pixel: [usize; 2]) -> (Vec<Hit>, f64) {
    let mut transmittance = 1.0;
    let mut found = Vec::new();
    for (index, p) in order.iter().filter_map(|&i| Some((i, projected[i].as_ref()?))) {
        let offset = [pixel[0] as f64 + 0.5 - p.mean[0], pixel[1] as f64 + 0.5 - p.mean[1]];
        let [a, b, c] = p.conic;
        let exponent = 0.5 * (a * offset[0] * offset[0] + c * offset[1] * offset[1])
            + b * offset[0] * offset[1];
        let weight = (-exponent).exp();
        let alpha = (p.opacity * weight).min(ALPHA_MAX);
        if exponent < 0.0 || alpha < ALPHA_CUT {
            continue;
        }
        if transmittance * (1.0 - alpha) < TRANSMITTANCE_STOP {
            break;
        }
        transmittance *= 1.0 - alpha;
        found.push(Hit { index, alpha, weight, offset });
    }
    (found, transmittance)
}

/// Blends `projected` (any order; sorted by depth here) over black.
pub fn blend(projected: &[Option<Projected>], width: usize, height: usize) -> Blended {
    let order = depth_order(projected);
    let pixels = width * height;
    let mut out =
        Blended { width, height, image: vec![0.0; 3 * pixels], transmittance: vec![1.0; pixels] };
    for pixel in 0..pixels {
        let (found, left) = hits(projected, &order, [pixel % width, pixel / width]);
        let mut transmittance = 1.0;
        for hit in found {
            let colour = projected[hit.index].as_ref().map_or([0.0; 3], |p| p.colour);
            for (channel, value) in colour.into_iter().enumerate() {
                out.image[channel * pixels + pixel] += transmittance * hit.alpha * value;
            }
            transmittance *= 1.0 - hit.alpha;
        }
        out.transmittance[pixel] = left;
    }
    out
}

impl Blended {
    /// The image over this background instead of black.
    #[must_use]
    pub fn before(mut self, background: [f64; 3]) -> Self {
        let pixels = self.transmittance.len();
        for (channel, value) in background.into_iter().enumerate() {
            for (pixel, left) in self.transmittance.iter().enumerate() {
                self.image[channel * pixels + pixel] += left * value;
            }
        }
        self
    }
}

/// Gradients by every projected splat for `image_gradient`, planar [3, H, W].
pub fn blend_backward(
    projected: &[Option<Projected>],
    blended: &Blended,
    image_gradient: &[f64],
) -> Vec<ProjectedGradient> {
    let order = depth_order(projected);
    let pixels = blended.width * blended.height;
    let mut out = vec![ProjectedGradient::default(); projected.len()];
    for pixel in 0..pixels {
        let channels = [0, 1, 2].map(|c| c * pixels + pixel);
        let upstream = channels.map(|i| image_gradient[i]);
        let total = channels.map(|i| blended.image[i]);
        let (found, _) = hits(projected, &order, [pixel % blended.width, pixel / blended.width]);
        let mut transmittance = 1.0;
        let mut so_far = [0.0; 3];
        for hit in found {
            let Some(p) = projected[hit.index].as_ref() else {
                continue;
            };
            let gradient = &mut out[hit.index];
            let mut by_alpha = 0.0;
            for c in 0..3 {
                so_far[c] += transmittance * hit.alpha * p.colour[c];
                gradient.colour[c] += upstream[c] * transmittance * hit.alpha;
                let behind = (total[c] - so_far[c]) / (1.0 - hit.alpha);
                by_alpha += upstream[c] * (transmittance * p.colour[c] - behind);
            }
            transmittance *= 1.0 - hit.alpha;
            if p.opacity * hit.weight < ALPHA_MAX {
                alpha_backward(p, &hit, by_alpha, gradient);
            }
        }
    }
    out
}

fn alpha_backward(p: &Projected, hit: &Hit, by_alpha: f64, gradient: &mut ProjectedGradient) {
    let [dx, dy] = hit.offset;
    let [a, b, c] = p.conic;
    let by_exponent = -by_alpha * hit.alpha;
    gradient.opacity += by_alpha * hit.weight;
    gradient.conic[0] += by_exponent * 0.5 * dx * dx;
    gradient.conic[1] += by_exponent * dx * dy;
    gradient.conic[2] += by_exponent * 0.5 * dy * dy;
    // The offset is pixel minus mean.
    gradient.mean[0] -= by_exponent * (a * dx + b * dy);
    gradient.mean[1] -= by_exponent * (c * dy + b * dx);
}
