//! Tone curves: a longer exposure, and the paper's, based on the histogram of V.

use crate::image::{Image, Srgb, linear_to_srgb, srgb_to_linear};

use super::Anchor;

/// Bins of the histogram and entries of the table. The effect of alpha depends on this number: with
/// 1024 bins, alpha 10 brightens to a mean of 0.29 instead of 0.51.
pub const BINS: usize = 256;

/// V below which an image has no meaningful hue; keeps the gain finite.
const SMALLEST_V: f32 = 1e-4;

/// Light above which an exposure bends, white being 1. Below it the curve is exactly a gain; light
/// that reaches 1 stays within 0.04 of it, 0.017 encoded, so that clipped parts of the photographs
/// stay white.
const SHOULDER: f32 = 0.85;

/// The light of an exposure after the gain: the identity, then a parabola that reaches 1 with slope
/// 0.
fn shoulder(light: f32) -> f32 {
    let end = 2.0 - SHOULDER;
    if light <= SHOULDER {
        light
    } else if light >= end {
        1.0
    } else {
        light - (light - SHOULDER).powi(2) / (2.0 * (end - SHOULDER))
    }
}

/// The bins of a V between 0 and 1: the index of the lower one and the share of the upper one. NaN
/// counts as black.
fn bin(v: f32) -> (usize, f32) {
    let position = if v > 0.0 { v.min(1.0) * (BINS - 1) as f32 } else { 0.0 };
    let low = (position as usize).min(BINS - 2);
    (low, position - low as f32)
}

/// V of HSV: the largest channel.
pub(super) fn value(rgb: [f32; 3]) -> f32 {
    rgb[0].max(rgb[1]).max(rgb[2])
}

/// The histogram of V, with each pixel shared linearly between its two bins.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    bins: [f64; BINS],
}

impl Histogram {
    pub fn of(image: &Image<Srgb>) -> Self {
        Self::pooled([image])
    }

    /// The histogram of all images together, with equal weight per pixel.
    pub fn pooled<'a>(images: impl IntoIterator<Item = &'a Image<Srgb>>) -> Self {
        let mut histogram = Self { bins: [0.0; BINS] };
        images.into_iter().for_each(|image| histogram.add(image));
        histogram
    }

    /// Adds an image's pixels.
    pub fn add(&mut self, image: &Image<Srgb>) {
        let (red, green, blue) = (image.plane(0), image.plane(1), image.plane(2));
        for ((&r, &g), &b) in red.iter().zip(green).zip(blue) {
            let (low, share) = bin(value([r, g, b]));
            self.bins[low] += f64::from(1.0 - share);
            self.bins[low + 1] += f64::from(share);
        }
    }

    /// The counts, [256].
    pub fn bins(&self) -> &[f64; BINS] {
        &self.bins
    }

    /// Number of pixels.
    pub fn total(&self) -> f64 {
        self.bins.iter().sum()
    }

    /// The mean of V after a curve; 0 for an empty histogram.
    pub fn mean_through(&self, curve: &ToneCurve) -> f64 {
        self.mean_of(|v| f64::from(curve.map_v(v as f32)))
    }

    /// The mean of a function of V; 0 for an empty histogram.
    pub fn mean_of(&self, function: impl Fn(f64) -> f64) -> f64 {
        let mapped = |(k, count): (usize, &f64)| count * function(k as f64 / (BINS - 1) as f64);
        let total = self.total();
        if total > 0.0 {
            self.bins.iter().enumerate().map(mapped).sum::<f64>() / total
        } else {
            0.0
        }
    }

    /// The V that this share of the pixels below `end` does not exceed; 0 without any.
    pub fn quantile_below(&self, share: f64, end: f64) -> f64 {
        let below = &self.bins[..=(end.clamp(0.0, 1.0) * (BINS - 1) as f64) as usize];
        let wanted = share * below.iter().sum::<f64>();
        let mut sum = 0.0;
        let reached = below.iter().position(|count| {
            sum += count;
            sum > 0.0 && sum >= wanted
        });
        reached.unwrap_or(0) as f64 / (BINS - 1) as f64
    }

    /// The table of the equalisation with clip limit `alpha` (method 1): entries in 0..=1,
    /// ascending. `None` for alpha = 0 and for an empty histogram.
    fn equalisation(&self, alpha: f64) -> Option<[f32; BINS]> {
        let total = self.total();
        if alpha <= 0.0 || total <= 0.0 {
            return None;
        }
        let limit = (alpha * total / BINS as f64).max(1.0);
        let excess: f64 = self.bins.iter().map(|count| (count - limit).max(0.0)).sum();
        let mut sum = 0.0;
        // One redistribution pass, not iterated: a bin may end slightly above the limit.
        Some(self.bins.map(|count| {
            sum += count.min(limit) + excess / BINS as f64;
            (sum / total) as f32
        }))
    }
}

/// V' by a table, before the exponent.
fn equalised(table: &[f32; BINS], v: f32) -> f32 {
    let (low, share) = bin(v);
    table[low] + share * (table[low + 1] - table[low])
}

/// E(.; P): a monotone curve.
#[derive(Clone, Debug, PartialEq)]
pub struct ToneCurve(Family);

#[derive(Clone, Debug, PartialEq)]
enum Family {
    /// Applied to each channel.
    Exposure { gain: f32, black: f32 },
    /// Built for one histogram: a table on V that preserves hue and saturation, then an exponent.
    Equalised { table: Option<Box<[f32; BINS]>>, gamma: f32 },
}

impl ToneCurve {
    /// The curve of an anchor. The paper's family needs a histogram: a pooled one for the same tone
    /// in the whole scene, that of one image for the paper's reading.
    pub fn new(histogram: &Histogram, anchor: Anchor) -> Self {
        Self(match anchor {
            Anchor::Exposure { ev, black } => {
                Family::Exposure { gain: ev.exp2() as f32, black: black as f32 }
            }
            Anchor::Equalised { alpha, gamma } => Family::Equalised {
                table: histogram.equalisation(alpha).map(Box::new),
                gamma: gamma as f32,
            },
        })
    }

    /// The factor applied first to all channels of a colour.
    pub(super) fn gain(&self, v: f32) -> f32 {
        match &self.0 {
            Family::Equalised { table: Some(table), .. } => equalised(table, v) / v.max(SMALLEST_V),
            _ => 1.0,
        }
    }

    /// The value of a channel after [`ToneCurve::gain`], clipped to 0..=1.
    pub(super) fn channel(&self, value: f32) -> f32 {
        match self.0 {
            Family::Exposure { gain, black } => {
                let light = gain * srgb_to_linear(value.max(0.0)) - black;
                linear_to_srgb(shoulder(light.max(0.0)))
            }
            Family::Equalised { gamma, .. } => value.clamp(0.0, 1.0).powf(gamma),
        }
    }

    /// The mapped V, in 0..=1: monotone.
    pub fn map_v(&self, v: f32) -> f32 {
        match &self.0 {
            Family::Equalised { table: Some(table), .. } => self.channel(equalised(table, v)),
            _ => self.channel(v),
        }
    }

    /// Maps a colour, with each channel in 0..=1. Accepts any finite colour: negative channels
    /// become 0.
    pub fn apply_colour(&self, rgb: [f32; 3]) -> [f32; 3] {
        let gain = self.gain(value(rgb));
        rgb.map(|channel| self.channel(channel * gain))
    }

    /// Derivative of each channel by that channel alone, at a colour: the factor for small
    /// variations around it, such as the view-dependent part of a Gaussian's colour. Central
    /// differences over one 8-bit step; 0 where the curve clips.
    pub fn slope(&self, rgb: [f32; 3]) -> [f32; 3] {
        const STEP: f32 = 0.5 / 255.0;
        std::array::from_fn(|channel| {
            let at = |offset: f32| {
                let mut moved = rgb;
                moved[channel] = (moved[channel] + offset).clamp(0.0, 1.0);
                (moved[channel], self.apply_colour(moved)[channel])
            };
            let ((x0, y0), (x1, y1)) = (at(-STEP), at(STEP));
            if x1 > x0 { (y1 - y0) / (x1 - x0) } else { 0.0 }
        })
    }

    /// Applies the curve to an image.
    pub fn apply(&self, image: &Image<Srgb>) -> Image<Srgb> {
        let mut out = Image::new(image.width(), image.height());
        let n = image.pixels();
        let (red, rest) = out.data_mut().split_at_mut(n);
        let (green, blue) = rest.split_at_mut(n);
        for i in 0..n {
            let colour = [image.plane(0)[i], image.plane(1)[i], image.plane(2)[i]];
            [red[i], green[i], blue[i]] = self.apply_colour(colour);
        }
        out
    }
}

#[cfg(test)]
mod tests;
