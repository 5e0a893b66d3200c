//! The plane sweep of one photograph.

use glam::{DMat3, DVec3};

use super::map::{DepthMap, StereoView};

/// Planes, evenly spaced in inverse depth.
const PLANES: usize = 96;
/// Neighbours that a photograph is compared with.
const NEIGHBOURS: usize = 4;
/// The best two of them count: in the others it may be hidden.
const COUNTED: usize = 2;
/// Angle under which two photographs tell most about depth, degrees, and the least that tells
/// anything.
const BEST_ANGLE: f64 = 6.0;
const LEAST_ANGLE: f64 = 1.5;
/// Half the side of the window that is compared, px, and of that over which planes are averaged.
const WINDOW: usize = 3;
const SUPPORT: usize = 2;
/// Least deviation of the luma in a window: flat ones look like everything.
const LEAST_DEVIATION: f32 = 0.012;
/// Largest cost (1 - correlation) of a depth that is believed, ...
const MOST_COST: f32 = 0.45;
/// ... as a share of the cost of the next best plane at least [`APART`] planes away.
const MOST_RATIO: f32 = 0.9;
const APART: usize = 5;
/// Shares of the sparse points' inverse depths that lie before and behind the planes, and how much
/// further the planes reach.
const OUTSIDE: f64 = 0.005;
const BEHIND: f64 = 0.8;
const BEFORE: f64 = 1.15;
/// With fewer sparse points in the picture nobody knows where to look.
const LEAST_POINTS: usize = 20;
/// Cost where two pictures do not overlap: as of opposites.
const OPPOSITE: f32 = 2.0;

/// Depths of what the photograph of this index shows.
pub(super) fn depths(views: &[StereoView], index: usize, sparse: &[[f32; 3]]) -> DepthMap {
    let view = &views[index];
    let (width, height) = view.size();
    let nothing = || DepthMap {
        depths: vec![0.0; width * height],
    };
    let Some([far, near]) = inverse_depths(view, sparse) else {
        return nothing();
    };
    let neighbours = neighbours(views, index, 2.0 / (far + near));
    if neighbours.len() < COUNTED {
        return nothing();
    }
    let mut sweep = Sweep::new(view, &neighbours);
    let inverse = |plane: f64| far + (near - far) * plane / (PLANES - 1) as f64;
    let costs: Vec<Vec<f32>> = (0..PLANES)
        .map(|plane| sweep.cost(inverse(plane as f64)))
        .collect();
    let depth = |pixel: usize| {
        let textured = sweep.deviation[pixel] > LEAST_DEVIATION;
        let plane = textured.then(|| best_plane(&costs, pixel)).flatten();
        plane.map_or(0.0, |plane| (1.0 / inverse(plane)) as f32)
    };
    DepthMap {
        depths: (0..width * height).map(depth).collect(),
    }
}

/// Inverse depths of the furthest and the nearest plane.
pub(super) fn inverse_depths(view: &StereoView, sparse: &[[f32; 3]]) -> Option<[f64; 2]> {
    let seen = sparse.iter().filter_map(|point| {
        let (_, depth) = view.camera.shows(DVec3::from(point.map(f64::from)))?;
        Some(1.0 / depth)
    });
    let mut seen: Vec<f64> = seen.collect();
    if seen.len() < LEAST_POINTS {
        return None;
    }
    seen.sort_by(f64::total_cmp);
    let at = |share: f64| seen[((seen.len() - 1) as f64 * share).round() as usize];
    Some([BEHIND * at(OUTSIDE), BEFORE * at(1.0 - OUTSIDE)])
}

/// The photographs that tell most about what this one shows at `depth`.
fn neighbours(views: &[StereoView], index: usize, depth: f64) -> Vec<&StereoView> {
    let camera = &views[index].camera;
    let middle = camera.centre() + depth * camera.forward();
    let angle = |other: &StereoView| {
        let (here, there) = (middle - camera.centre(), middle - other.camera.centre());
        here.angle_between(there).to_degrees()
    };
    let others = views.iter().enumerate().filter(|(at, _)| *at != index);
    let mut telling: Vec<(f64, &StereoView)> = others
        .map(|(_, other)| (angle(other), other))
        .filter(|(angle, _)| *angle > LEAST_ANGLE)
        .collect();
    telling.sort_by(|(a, _), (b, _)| (a - BEST_ANGLE).abs().total_cmp(&(b - BEST_ANGLE).abs()));
    telling.truncate(NEIGHBOURS);
    telling.into_iter().map(|(_, other)| other).collect()
}

/// What stays the same from plane to plane.
struct Sweep<'a> {
    view: &'a StereoView,
    neighbours: Vec<(&'a StereoView, DMat3, DVec3)>,
    mean: Vec<f32>,
    deviation: Vec<f32>,
    scratch: Vec<f32>,
}

impl<'a> Sweep<'a> {
    fn new(view: &'a StereoView, neighbours: &[&'a StereoView]) -> Self {
        let size = view.size();
        let mut scratch = Vec::new();
        let squares: Vec<f32> = view.luma.iter().map(|v| v * v).collect();
        let mean = window_mean(&view.luma, size, WINDOW, &mut scratch);
        let squares = window_mean(&squares, size, WINDOW, &mut scratch);
        let deviation = deviations(&mean, &squares);
        let warped = |other: &&'a StereoView| {
            let (matrix, shift) = view.warp_to(other);
            (*other, matrix, shift)
        };
        Self {
            view,
            neighbours: neighbours.iter().map(warped).collect(),
            mean,
            deviation,
            scratch,
        }
    }

    /// 1 - the correlation of windows with those of the best neighbours, were everything on the
    /// plane of this inverse depth.
    fn cost(&mut self, inverse: f64) -> Vec<f32> {
        let pixels = self.view.luma.len();
        let mut best = vec![[OPPOSITE; COUNTED]; pixels];
        for (other, matrix, shift) in self.neighbours.clone() {
            let values = warped(self.view.size(), other, &matrix, shift * inverse);
            for (best, cost) in best.iter_mut().zip(self.compared(&values)) {
                // Sorted, the largest last.
                if cost < best[1] {
                    *best = [best[0].min(cost), best[0].max(cost)];
                }
            }
        }
        let means: Vec<f32> = best
            .iter()
            .map(|costs| 0.5 * (costs[0] + costs[1]))
            .collect();
        window_mean(&means, self.view.size(), SUPPORT, &mut self.scratch)
    }

    /// 1 - the correlation of each window with that of another picture; where this one ends its
    /// values are not finite.
    fn compared(&mut self, other: &[f32]) -> Vec<f32> {
        let size = self.view.size();
        let known: Vec<f32> = other
            .iter()
            .map(|v| if v.is_finite() { *v } else { 0.0 })
            .collect();
        let squares: Vec<f32> = known.iter().map(|v| v * v).collect();
        let products = known.iter().zip(&self.view.luma).map(|(a, b)| a * b);
        let products: Vec<f32> = products.collect();
        let scratch = &mut self.scratch;
        let mean = window_mean(&known, size, WINDOW, scratch);
        let squares = window_mean(&squares, size, WINDOW, scratch);
        let products = window_mean(&products, size, WINDOW, scratch);
        let deviation = deviations(&mean, &squares);
        let cost = |i: usize| {
            if !other[i].is_finite() {
                return OPPOSITE;
            }
            let covariance = products[i] - mean[i] * self.mean[i];
            1.0 - covariance / (deviation[i] * self.deviation[i])
        };
        (0..other.len()).map(cost).collect()
    }
}

/// Standard deviations from means and means of squares, never 0.
fn deviations(mean: &[f32], squares: &[f32]) -> Vec<f32> {
    let deviation = |(mean, square): (&f32, &f32)| (square - mean * mean).max(1e-6).sqrt();
    mean.iter().zip(squares).map(deviation).collect()
}

/// Another photograph as this one would see it, were everything on one plane; not finite beyond its
/// border.
fn warped(
    (width, height): (usize, usize),
    other: &StereoView,
    matrix: &DMat3,
    shift: DVec3,
) -> Vec<f32> {
    let (other_width, other_height) = other.size();
    let mut values = Vec::with_capacity(width * height);
    for y in 0..height {
        let start = matrix.x_axis * 0.5 + matrix.y_axis * (y as f64 + 0.5) + matrix.z_axis + shift;
        for x in 0..width {
            let place = start + matrix.x_axis * x as f64;
            // Rounded before they are compared: what is rounded up to the border lies on it.
            let (u, v) = (place.x / place.z - 0.5, place.y / place.z - 0.5);
            let (u, v) = (u as f32, v as f32);
            let inside = place.z > 0.0
                && u >= 0.0
                && v >= 0.0
                && u < (other_width - 1) as f32
                && v < (other_height - 1) as f32;
            values.push(if inside {
                bilinear(&other.luma, other_width, u, v)
            } else {
                f32::NAN
            });
        }
    }
    values
}

fn bilinear(values: &[f32], width: usize, u: f32, v: f32) -> f32 {
    let (column, row) = (u as usize, v as usize);
    let (across, down) = (u - column as f32, v - row as f32);
    let at = row * width + column;
    let upper = values[at] + across * (values[at + 1] - values[at]);
    let below = at + width;
    let lower = values[below] + across * (values[below + 1] - values[below]);
    upper + down * (lower - upper)
}

/// The plane of a pixel, between planes by a parabola; `None` where no plane stands out.
fn best_plane(costs: &[Vec<f32>], pixel: usize) -> Option<f64> {
    let cost = |plane: usize| costs[plane][pixel];
    let planes = 0..costs.len();
    let best = planes
        .clone()
        .min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
    let apart = planes.filter(|plane| plane.abs_diff(best) >= APART);
    let second = apart.map(cost).fold(f32::INFINITY, f32::min);
    let stands_out = cost(best) < MOST_COST && cost(best) < MOST_RATIO * second;
    if !stands_out || best == 0 || best + 1 == costs.len() {
        return None;
    }
    let [before, here, after] = [best - 1, best, best + 1].map(|plane| f64::from(cost(plane)));
    let bend = before - 2.0 * here + after;
    let off = if bend > 0.0 {
        0.5 * (before - after) / bend
    } else {
        0.0
    };
    Some(best as f64 + off.clamp(-0.5, 0.5))
}

/// Means over windows of `radius` px to each side, smaller ones at the border.
fn window_mean(
    values: &[f32],
    (width, height): (usize, usize),
    radius: usize,
    scratch: &mut Vec<f32>,
) -> Vec<f32> {
    scratch.clear();
    scratch.resize(values.len(), 0.0);
    for (row, out) in values.chunks(width).zip(scratch.chunks_mut(width)) {
        let mut sum: f32 = row[..radius.min(width)].iter().sum();
        for x in 0..width {
            if x + radius < width {
                sum += row[x + radius];
            }
            if x > radius {
                sum -= row[x - radius - 1];
            }
            let count = (x + radius + 1).min(width) - x.saturating_sub(radius);
            out[x] = sum / count as f32;
        }
    }
    let mut means = vec![0.0; values.len()];
    let mut sums: Vec<f32> = vec![0.0; width];
    for y in 0..radius.min(height) {
        add(&mut sums, &scratch[y * width..][..width], 1.0);
    }
    for y in 0..height {
        if y + radius < height {
            add(&mut sums, &scratch[(y + radius) * width..][..width], 1.0);
        }
        if y > radius {
            add(
                &mut sums,
                &scratch[(y - radius - 1) * width..][..width],
                -1.0,
            );
        }
        let count = (y + radius + 1).min(height) - y.saturating_sub(radius);
        let row = means[y * width..][..width].iter_mut().zip(&sums);
        row.for_each(|(mean, sum)| *mean = sum / count as f32);
    }
    means
}

fn add(sums: &mut [f32], row: &[f32], sign: f32) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += sign * value;
    }
}
