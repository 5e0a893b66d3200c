//! Derivatives by the parameters.
//!
//! Strips of the image, a block wide and a fixed share of the rows high, are tasks with separate
//! sums, which are added in the order of the strips, so the bits do not depend on threads.

use std::ops::Range;

use rayon::prelude::*;

use super::block::{Block, PIXELS, Place};
use super::encoding::{COORDINATE, DIRECTION};
use super::network::{
    Coordinates, MIDDLE, Network, PARAMETERS, colour_bias, colour_weight, combined, first_bias,
    first_weights, middle_weights,
};
use super::product::{PANELS, Row, WIDTH, Weights, ZERO, numbers};
use crate::View;
use crate::simd::{LANES, Lanes, load, sum, vectorised};

/// Approximate number of strips of an image; each has 300 KiB of sums.
const STRIPS: usize = 64;
/// Parameters per task of the addition.
const ADDED: usize = 4096;

/// The sums of a strip.
pub(super) struct Gradient {
    /// The first row of the image.
    pub(super) top: usize,
    /// Of the derivative by the first layer's sums: over the rows of each column, and over the
    /// columns of each row.
    pub(super) columns: Vec<Row>,
    pub(super) rows: Vec<Row>,
    /// By the weights and biases of the layers between the first and the colour.
    pub(super) weights: Vec<Weights>,
    pub(super) biases: [Row; MIDDLE],
    /// By the colour's weights, those of the direction's numbers and its biases by lanes.
    pub(super) colour: [Row; 3],
    pub(super) direction: [[Lanes; 3]; DIRECTION],
    pub(super) colour_bias: [Lanes; 3],
}

/// A strip of the image.
struct Strip {
    x: usize,
    count: usize,
    rows: Range<usize>,
}

/// The finished sums of a strip.
struct Part {
    x: usize,
    top: usize,
    columns: Vec<Row>,
    rows: Vec<Row>,
    /// In the layout of the parameters, without the first layer.
    parameters: Vec<f32>,
}

fn strips([width, height]: [usize; 2]) -> Vec<Strip> {
    let blocks = width.div_ceil(PIXELS).max(1);
    let high = height.div_ceil((STRIPS / blocks).max(1)).max(1);
    let bands = (0..height).step_by(high).map(|top| top..(top + high).min(height));
    let strip = |rows: Range<usize>| {
        Place::all(width, 0).map(move |at| Strip { x: at.x, count: at.count, rows: rows.clone() })
    };
    bands.flat_map(strip).collect()
}

/// The derivative by every parameter, given that by the prediction, planar [3, height, width].
pub(super) fn by_parameters(
    network: &Network,
    coordinates: &Coordinates,
    view: &View,
    by_prediction: &[f32],
) -> Vec<f32> {
    let strips = strips(view.size);
    let parts: Vec<Part> =
        strips.par_iter().map(|strip| strip.part(network, view, by_prediction)).collect();
    let mut out = vec![0.0; PARAMETERS];
    out.par_chunks_mut(ADDED).enumerate().for_each(|(task, out)| {
        for part in &parts {
            let values = &part.parameters[task * ADDED..][..out.len()];
            out.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        }
    });
    add_first_layer(&parts, coordinates, &mut out);
    out
}

impl Strip {
    fn part(&self, network: &Network, view: &View, by_prediction: &[f32]) -> Part {
        let [width, height] = view.size;
        let mut sums = Gradient::new(self);
        let mut block = Block::default();
        for y in self.rows.clone() {
            let row = |channel: usize| &by_prediction[(channel * height + y) * width..][..width];
            let place = Place { x: self.x, y, count: self.count };
            block.add_gradient((network, view), place, [row(0), row(1), row(2)], &mut sums);
        }
        sums.finish(self.x)
    }
}

impl Gradient {
    fn new(strip: &Strip) -> Self {
        Self {
            top: strip.rows.start,
            columns: vec![ZERO; strip.count],
            rows: vec![ZERO; strip.rows.len()],
            weights: vec![[[ZERO[0]; WIDTH]; PANELS]; MIDDLE],
            biases: [ZERO; MIDDLE],
            colour: [ZERO; 3],
            direction: [[[0.0; LANES]; 3]; DIRECTION],
            colour_bias: [[0.0; LANES]; 3],
        }
    }

    fn finish(self, x: usize) -> Part {
        let mut out = vec![0.0; PARAMETERS];
        for (layer, weights) in self.weights.iter().enumerate() {
            for input in 0..WIDTH {
                let out = &mut out[middle_weights(layer, input)];
                for (out, panel) in out.chunks_exact_mut(WIDTH / PANELS).zip(weights) {
                    out.copy_from_slice(panel[input].as_flattened());
                }
            }
            out[middle_weights(layer, WIDTH)].copy_from_slice(numbers(&self.biases[layer]));
        }
        let total = |lanes: &Lanes| vectorised!(simd => sum(load(simd, lanes)));
        for channel in 0..3 {
            for (input, value) in numbers(&self.colour[channel]).iter().enumerate() {
                out[colour_weight(input, channel)] = *value;
            }
            for (n, sums) in self.direction.iter().enumerate() {
                out[colour_weight(WIDTH + n, channel)] = total(&sums[channel]);
            }
            out[colour_bias(channel)] = total(&self.colour_bias[channel]);
        }
        Part { x, top: self.top, columns: self.columns, rows: self.rows, parameters: out }
    }
}

fn add_first_layer(parts: &[Part], coordinates: &Coordinates, out: &mut [f32]) {
    let [width, height] = &coordinates.sides;
    let (mut columns, mut rows) = (vec![ZERO; width.len()], vec![ZERO; height.len()]);
    for part in parts {
        add_rows(&part.columns, &mut columns[part.x..]);
        add_rows(&part.rows, &mut rows[part.top..]);
    }
    vectorised!(simd => {
        let mut set = |to: Range<usize>, by: &[f32], rows: &[Row]| {
            let values = combined(simd, by, rows, &ZERO);
            out[to].copy_from_slice(numbers(&values));
        };
        let ones = vec![1.0; rows.len()];
        set(first_bias(), &ones, &rows);
        for n in 0..COORDINATE {
            let along = |side: &[[f32; COORDINATE]]| -> Vec<f32> {
                side.iter().map(|numbers| numbers[n]).collect()
            };
            set(first_weights(0, n), &along(width), &columns);
            set(first_weights(1, n), &along(height), &rows);
            set(first_weights(2, n), &vec![coordinates.depth[n]; rows.len()], &rows);
        }
    });
}

fn add_rows(from: &[Row], to: &mut [Row]) {
    for (to, from) in to.iter_mut().zip(from) {
        let to = to.as_flattened_mut().as_flattened_mut();
        to.iter_mut().zip(numbers(from)).for_each(|(sum, value)| *sum += value);
    }
}
