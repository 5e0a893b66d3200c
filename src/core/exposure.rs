//! The exposure and white balance of each photograph, relative to the others of its capture.
//!
//! Differs from the paper, which brightens all photographs alike: automatic exposure gives each its
//! own, and a scene trained on all of them is inconsistent. If two views show the same surface, the
//! ratio of their light is that of their gains; one gain per channel and view is solved from all
//! pairs.

use glam::DVec3;
use rayon::prelude::*;

use crate::camera::Camera;
use crate::image::{Image, Linear};
use crate::mask::Mask;

/// Largest relative difference in depth at which two views see the same surface.
const SAME_DEPTH: f64 = 0.03;
/// Light from which a channel may be clipped, or compressed by the camera's curve.
const MOST_LIGHT: f32 = 0.7;
/// Light below which quantisation and clipped noise determine the value.
const LEAST_LIGHT: f32 = 0.002;
/// Share of a pair's pixels that is left out as too dark: noise there is clipped at black.
const DARK_SHARE: f64 = 0.4;
/// Fewest pixels that determine a pair's ratio, and the number above which more add nothing.
const LEAST_PIXELS: usize = 60;
const MOST_PIXELS: f64 = 1_000.0;
/// Residual of a pair beyond which it counts linearly instead of by its square (Huber), stops.
const BEND: f64 = 0.1;
/// Weight of a view's prior, relative to a pair of full weight.
const PRIOR: f64 = 0.001;
/// The solver's repetitions: with new weights, and within one.
const REWEIGHTED: usize = 10;
const SWEEPS: usize = 200;

/// Light of a photograph relative to the capture's neutral exposure, by channel, stops.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gains {
    /// Red, green, blue.
    pub stops: [f64; 3],
}

impl Gains {
    /// From [`Gains::exposure`] and [`Gains::tint`].
    pub fn of(exposure: f64, [red, blue]: [f64; 2]) -> Self {
        let green = exposure - (red + blue) / 3.0;
        Self { stops: [green + red, green, green + blue] }
    }

    /// The exposure: the mean of the channels, stops.
    pub fn exposure(&self) -> f64 {
        self.stops.iter().sum::<f64>() / 3.0
    }

    /// Red and blue relative to green, stops.
    pub fn tint(&self) -> [f64; 2] {
        [self.stops[0] - self.stops[1], self.stops[2] - self.stops[1]]
    }

    /// The gains multiplied by this share.
    #[must_use]
    pub fn scaled(&self, share: f64) -> Self {
        Self { stops: self.stops.map(|stops| share * stops) }
    }

    /// A photograph converted to the neutral exposure. Nothing is clipped; without gains it is
    /// unchanged, bit for bit.
    #[must_use]
    pub fn even(&self, photograph: &Image) -> Image {
        self.scaled(-1.0).expose(photograph)
    }

    /// A picture in neutral exposure, converted to the exposure of the photograph.
    #[must_use]
    pub fn expose(&self, neutral: &Image) -> Image {
        if self.stops == [0.0; 3] {
            return neutral.clone();
        }
        let mut light = neutral.to_linear();
        for (channel, stops) in self.stops.into_iter().enumerate() {
            let gain = stops.exp2() as f32;
            light.plane_mut(channel).iter_mut().for_each(|value| *value *= gain);
        }
        light.to_srgb()
    }
}

/// A view for the comparison of surfaces.
#[derive(Clone, Copy)]
pub struct Surface<'a> {
    /// At the size of the photograph.
    pub camera: &'a Camera,
    pub photograph: &'a Image<Linear>,
    /// Depth of the scene at each pixel, row by row, world units along the camera's axis; `None` if
    /// there is none.
    pub depth: &'a [Option<f32>],
    /// The pixels that count; all without one.
    pub mask: Option<&'a Mask>,
}

/// The ratio of the light of two views on the surfaces that both show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ratio {
    /// Indices of the views.
    pub views: [usize; 2],
    /// Light of the first view relative to the second, stops by channel.
    pub stops: [f64; 3],
    /// Number of pixels of the first view on those surfaces.
    pub pixels: usize,
}

impl Ratio {
    /// Its weight, relative to a pair of full weight.
    fn weight(&self) -> f64 {
        (self.pixels as f64 / MOST_PIXELS).min(1.0)
    }
}

/// The ratios of all ordered pairs of views that show enough common surface.
pub fn ratios(views: &[Surface<'_>]) -> Vec<Ratio> {
    let of_view = |first: usize| {
        let points = surface_points(&views[first]);
        let others = (0..views.len()).filter(move |second| *second != first);
        let ratio = |second| ratio(views, [first, second], &points);
        others.filter_map(ratio).collect::<Vec<_>>()
    };
    (0..views.len()).into_par_iter().flat_map_iter(of_view).collect()
}

/// A pixel of a view, and the world point that it shows.
struct SurfacePoint {
    light: [f32; 3],
    point: DVec3,
}

fn surface_points(view: &Surface<'_>) -> Vec<SurfacePoint> {
    let k = view.camera.intrinsics;
    let to_world = view.camera.rotation().transpose();
    let origin = view.camera.centre();
    let mut points = Vec::new();
    for y in 1..k.height.saturating_sub(1) {
        for x in 1..k.width.saturating_sub(1) {
            let Some(light) = usable(view, x, y) else { continue };
            let Some(depth) = view.depth[y * k.width + x] else { continue };
            let ray =
                DVec3::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy, 1.0);
            points
                .push(SurfacePoint { light, point: origin + to_world * (f64::from(depth) * ray) });
        }
    }
    points
}

/// The light of a pixel, if it counts and its value is neither clipped nor too dark.
fn usable(view: &Surface<'_>, x: usize, y: usize) -> Option<[f32; 3]> {
    if view.mask.is_some_and(|mask| !mask.holds(x, y)) {
        return None;
    }
    let light = view.photograph.get(x, y);
    light.iter().all(|value| (LEAST_LIGHT..MOST_LIGHT).contains(value)).then_some(light)
}

fn ratio(views: &[Surface<'_>], pair: [usize; 2], points: &[SurfacePoint]) -> Option<Ratio> {
    let other = &views[pair[1]];
    let mut common: Vec<([f32; 3], f32)> = Vec::new();
    for SurfacePoint { light, point } in points {
        let Some((pixel, depth)) = other.camera.shows(*point) else { continue };
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        let is_same = |seen: f32| (f64::from(seen) - depth).abs() <= SAME_DEPTH * depth;
        if !other.depth[y * other.photograph.width() + x].is_some_and(is_same) {
            continue;
        }
        let Some(seen) = usable(other, x, y) else { continue };
        let of = |channel: usize| (light[channel] / seen[channel]).log2();
        common.push((std::array::from_fn(of), light[1] * seen[1]));
    }
    let dark = (DARK_SHARE * common.len() as f64) as usize;
    if common.len() - dark < LEAST_PIXELS {
        return None;
    }
    common.select_nth_unstable_by(dark, |a, b| a.1.total_cmp(&b.1));
    let bright = &common[dark..];
    let middle = |channel: usize| {
        let mut stops: Vec<f32> = bright.iter().map(|(stops, _)| stops[channel]).collect();
        let at = stops.len() / 2;
        f64::from(*stops.select_nth_unstable_by(at, f32::total_cmp).1)
    };
    Some(Ratio { views: pair, stops: std::array::from_fn(middle), pixels: bright.len() })
}

/// The gains that best explain the ratios.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// By view. If none was known, their mean over the views is zero.
    pub gains: Vec<Gains>,
    /// Standard deviation of the residuals of the pairs' ratios, stops, from their median over
    /// pairs and channels. `None` without pairs.
    pub residual: Option<f64>,
}

/// Solves for the gains of the views that are not `known` by robust least squares over the pairs.
/// `prior` is an exposure of each view, stops, that decides where no pair does.
pub fn solve(known: &[Option<Gains>], ratios: &[Ratio], prior: &[f64]) -> Solution {
    let mut gains = vec![Gains::default(); known.len()];
    let mut residuals = Vec::new();
    for channel in 0..3 {
        let known: Vec<Option<f64>> =
            known.iter().map(|known| known.map(|gains| gains.stops[channel])).collect();
        let stops = solved(&known, ratios, channel, prior);
        for (gains, stops) in gains.iter_mut().zip(&stops) {
            gains.stops[channel] = *stops;
        }
        let left = |ratio: &Ratio| (residual(ratio, channel, &stops).abs(), ratio.weight());
        residuals.extend(ratios.iter().map(left));
    }
    let residual = weighted_median(residuals).map(|median| 1.4826 * median);
    Solution { gains, residual }
}

/// The value up to which half of the weight lies; `None` without values.
fn weighted_median(mut values: Vec<(f64, f64)>) -> Option<f64> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = values.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    reached.map(|(value, _)| *value)
}

fn residual(ratio: &Ratio, channel: usize, stops: &[f64]) -> f64 {
    let [first, second] = ratio.views.map(|view| stops[view]);
    ratio.stops[channel] - (first - second)
}

/// One channel, by Gauss-Seidel.
fn solved(known: &[Option<f64>], ratios: &[Ratio], channel: usize, prior: &[f64]) -> Vec<f64> {
    let first_guess = |(known, prior): (&Option<f64>, &f64)| known.unwrap_or(*prior);
    let mut stops: Vec<f64> = known.iter().zip(prior).map(first_guess).collect();
    let mut neighbours: Vec<Vec<(usize, f64, f64)>> = vec![Vec::new(); known.len()];
    for _ in 0..REWEIGHTED {
        neighbours.iter_mut().for_each(Vec::clear);
        for ratio in ratios {
            let left = residual(ratio, channel, &stops).abs();
            let robust = if left <= BEND { 1.0 } else { BEND / left };
            let weight = robust * ratio.weight();
            let [first, second] = ratio.views;
            neighbours[first].push((second, ratio.stops[channel], weight));
            neighbours[second].push((first, -ratio.stops[channel], weight));
        }
        for _ in 0..SWEEPS {
            for view in (0..known.len()).filter(|view| known[*view].is_none()) {
                let (mut sum, mut weights) = (PRIOR * prior[view], PRIOR);
                for (other, ratio, weight) in &neighbours[view] {
                    sum += weight * (stops[*other] + ratio);
                    weights += weight;
                }
                stops[view] = sum / weights;
            }
        }
    }
    if known.iter().all(Option::is_none) {
        let mean = stops.iter().sum::<f64>() / known.len().max(1) as f64;
        stops.iter_mut().for_each(|stops| *stops -= mean);
    }
    stops
}

#[cfg(test)]
mod tests;
