//! The reference of the shake in `f64`, tap by tap.

use super::{Response, ShakeKernel};
#[cfg(test)]
use super::{SMOOTH_BEND, SMOOTH_WEIGHT};

/// A view's shake: its image's size in px, its kernel, its response.
pub struct ReferenceShake<'a> {
    /// Width and height, px.
    pub size: [usize; 2],
    pub kernel: &'a ShakeKernel,
    /// The response from light to values.
    pub response: &'a Response,
}

impl ReferenceShake<'_> {
    /// Pairs of pixels that a tap connects (source and target of the light), with its weight.
    fn paths(&self) -> impl Iterator<Item = (usize, usize, f64)> + '_ {
        let [width, height] = self.size;
        self.kernel.taps().iter().flat_map(move |tap| {
            (0..width * height).filter_map(move |from| {
                let x = (from % width) as i64 + i64::from(tap.offset[0]);
                let y = (from / width) as i64 + i64::from(tap.offset[1]);
                let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
                inside.then(|| {
                    let to = [x as usize, y as usize];
                    (from, to[1] * width + to[0], tap.weight_at(to, self.size))
                })
            })
        })
    }

    /// Mean light of every pixel [3, H, W], and the sum of weights there [H, W].
    fn arrived(&self, render: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let pixels = self.size[0] * self.size[1];
        let (mut sums, mut weights) = (vec![0.0; 3 * pixels], vec![0.0; pixels]);
        for (from, to, weight) in self.paths() {
            weights[to] += weight;
            for plane in [0, pixels, 2 * pixels] {
                sums[plane + to] += weight * self.response.light(render[plane + from]);
            }
        }
        for (index, sum) in sums.iter_mut().enumerate() {
            let weight = weights[index % pixels];
            *sum = if weight > 0.0 { *sum / weight } else { 0.0 };
        }
        (sums, weights)
    }

    /// `f(k * f^-1(render))` of a planar render [3, H, W], without the light that leaves the image.
    pub fn shaken(&self, render: &[f64]) -> Vec<f64> {
        self.arrived(render).0.into_iter().map(|light| self.response.value(light)).collect()
    }
}

#[cfg(test)]
impl ReferenceShake<'_> {
    /// The derivative by the render of `sum(gradient * shaken(render)) + smooth_weight *
    /// roughness(render)`.
    pub fn gradient(&self, render: &[f64], gradient: &[f64]) -> Vec<f64> {
        let pixels = self.size[0] * self.size[1];
        let (light, weights) = self.arrived(render);
        let mut out = self.roughness_gradient(render);
        for (from, to, weight) in self.paths() {
            for plane in [0, pixels, 2 * pixels] {
                let by_light = gradient[plane + to] * self.response.value_slope(light[plane + to])
                    / weights[to];
                out[plane + from] +=
                    weight * by_light * self.response.light_slope(render[plane + from]);
            }
        }
        out
    }

    /// `weight * sum over neighbours of sqrt(d^2 + bend^2)`, the total variation of the render.
    pub fn roughness(&self, render: &[f64]) -> f64 {
        self.neighbours()
            .map(|(a, b)| self.bend() * (render[a] - render[b]).hypot(SMOOTH_BEND))
            .sum()
    }

    fn roughness_gradient(&self, render: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; render.len()];
        for (a, b) in self.neighbours() {
            let d = render[a] - render[b];
            let slope = self.bend() * d / d.hypot(SMOOTH_BEND);
            out[a] += slope;
            out[b] -= slope;
        }
        out
    }

    fn bend(&self) -> f64 {
        SMOOTH_WEIGHT / (3 * self.size[0] * self.size[1]) as f64
    }

    /// Horizontal and vertical pairs of values of one channel.
    fn neighbours(&self) -> impl Iterator<Item = (usize, usize)> {
        let [width, height] = self.size;
        (0..3 * width * height).flat_map(move |at| {
            let (x, y) = (at % width, at / width % height);
            let right = (x + 1 < width).then_some((at, at + 1));
            let below = (y + 1 < height).then_some((at, at + width));
            right.into_iter().chain(below)
        })
    }
}
