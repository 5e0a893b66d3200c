//! From the samples of a sensor, one colour each, to pixels of three.

use std::collections::VecDeque;

use flashraw::{CfaPattern, Rect};

use super::channel;
use crate::image::{Image, Linear};

/// Normalised samples of a sensor, row by row.
pub(super) struct Mosaic<'a> {
    pub(super) samples: &'a [f32],
    /// Samples in a row, over `cpp`.
    pub(super) width: usize,
    /// Samples a pixel: 1, or 3 where the camera has merged the colours.
    pub(super) cpp: usize,
    /// The colours of the samples; none if a sample has no colour or a pixel all.
    pub(super) cfa: Option<CfaPattern>,
    /// The part that is the picture.
    pub(super) crop: Rect,
}

/// For each channel, a sum of weighted samples and the sum of their weights.
type Sums = [[f32; 2]; 3];

/// One axis: the samples that reach each output pixel, and how far.
struct Reach {
    first: usize,
    weights: Vec<f32>,
}

impl Mosaic<'_> {
    /// The picture at another size: each channel of a pixel is the weighted mean of the samples of
    /// its colour. A sample covers a square centred on it, as wide as the period of its colour; its
    /// weight is the part of that square inside the pixel. At full size this is bilinear
    /// interpolation, at small sizes an area average, and no colour is shifted against another.
    ///
    /// Samples are multiplied by the white balance, and cut at white, which makes clipped lights
    /// neutral. Nothing is cut at black.
    pub(super) fn averaged(
        &self,
        (width, height): (usize, usize),
        balance: [f32; 3],
    ) -> Image<Linear> {
        let (x0, y0) = (self.crop.x as usize, self.crop.y as usize);
        let half = self.half_reach();
        let columns = reaches(self.crop.width as usize, width, half);
        let rows = reaches(self.crop.height as usize, height, half);
        let mut image = Image::<Linear>::new(width, height);
        let mut line = vec![0.0; self.crop.width as usize * self.cpp];
        // The rows of the sensor that reach the pixels of a row, summed along it.
        let mut narrowed: VecDeque<(usize, Vec<Sums>)> = VecDeque::new();
        for (row, reach) in rows.iter().enumerate() {
            while narrowed.front().is_some_and(|(y, _)| *y < reach.first) {
                narrowed.pop_front();
            }
            let next = narrowed.back().map_or(reach.first, |(y, _)| y + 1);
            for y in next..reach.first + reach.weights.len() {
                self.balanced(x0, y0 + y, balance, &mut line);
                let colours = self.colours(x0, y0 + y);
                let of = |column| summed(&line, column, &colours, self.cpp);
                narrowed.push_back((y, columns.iter().map(of).collect()));
            }
            for x in 0..width {
                let rows = narrowed.iter().zip(&reach.weights);
                let light = [0, 1, 2].map(|channel| {
                    let of = |part: usize| {
                        rows.clone().map(move |((_, sums), weight)| weight * sums[x][channel][part])
                    };
                    let (sum, weight): (f32, f32) = (of(0).sum(), of(1).sum());
                    if weight > 0.0 { sum / weight } else { 0.0 }
                });
                image.set(x, row, light);
            }
        }
        image
    }

    /// How far a sample reaches from its centre, px.
    fn half_reach(&self) -> f64 {
        match &self.cfa {
            None => 0.5,
            Some(cfa) if cfa.width() == 2 && cfa.height() == 2 => 1.0,
            Some(cfa) if cfa.width() == 6 => 1.5,
            // Four equal colours side by side.
            Some(_) => 2.0,
        }
    }

    /// A row of the picture, balanced.
    fn balanced(&self, x0: usize, y: usize, balance: [f32; 3], line: &mut [f32]) {
        let start = (y * self.width + x0) * self.cpp;
        let samples = &self.samples[start..start + line.len()];
        let colours = self.colours(x0, y);
        for (index, (to, sample)) in line.iter_mut().zip(samples).enumerate() {
            let gain = match self.cpp {
                1 => colours[index % colours.len()].map_or(1.0, |channel| balance[channel]),
                cpp => balance[(index % cpp).min(2)],
            };
            let light = gain * sample;
            // A shading map may leave what is no number.
            *to = if light.is_nan() { 0.0 } else { light.clamp(-1.0, 1.0) };
        }
    }

    /// The channels of the samples of a row, from `x0` on, as a period; none for all channels.
    fn colours(&self, x0: usize, y: usize) -> Vec<Option<usize>> {
        self.cfa.as_ref().map_or_else(
            || vec![None],
            |cfa| (0..cfa.width()).map(|x| channel(cfa.color_at(x0 + x, y))).collect(),
        )
    }
}

/// The weighted samples of a row that reach an output pixel, and their weights.
fn summed(line: &[f32], column: &Reach, colours: &[Option<usize>], cpp: usize) -> Sums {
    let mut sums = Sums::default();
    let mut add = |channel: usize, weight: f32, value: f32| {
        let [sum, total] = &mut sums[channel];
        *sum += weight * value;
        *total += weight;
    };
    let mut phase = column.first % colours.len();
    for (offset, &weight) in column.weights.iter().enumerate() {
        let x = column.first + offset;
        match colours[phase] {
            Some(channel) => add(channel, weight, line[x]),
            None if cpp > 1 => (0..3).for_each(|c| add(c, weight, line[x * cpp + c])),
            None => (0..3).for_each(|c| add(c, weight, line[x])),
        }
        phase = if phase + 1 == colours.len() { 0 } else { phase + 1 };
    }
    sums
}

/// The reach of `from` samples of half width `half` on an axis of `to` pixels.
fn reaches(from: usize, to: usize, half: f64) -> Vec<Reach> {
    let step = from as f64 / to as f64;
    let of = |pixel: usize| {
        let (start, end) = (pixel as f64 * step, (pixel + 1) as f64 * step);
        let first = ((start - half - 0.5).floor().max(0.0) as usize).min(from - 1);
        let last = ((end + half + 0.5).ceil() as usize).clamp(first + 1, from);
        let reached = |sample: usize| {
            let centre = sample as f64 + 0.5;
            ((centre + half).min(end) - (centre - half).max(start)).max(0.0) as f32
        };
        let weights: Vec<f32> = (first..last).map(reached).collect();
        let empty = weights.iter().take_while(|weight| **weight == 0.0).count();
        let end = weights.len() - weights.iter().rev().take_while(|w| **w == 0.0).count();
        Reach { first: first + empty, weights: weights[empty..end.max(empty)].to_vec() }
    };
    (0..to).map(of).collect()
}
