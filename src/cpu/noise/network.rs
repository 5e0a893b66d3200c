//! The network's parameters, in the layout of the core's `Network`, and in that of the products.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::encoding::{COORDINATE, DIRECTION, depth, side};
use super::product::{PANELS, Row, WIDTH, Weights, ZERO, numbers, vectors};
use crate::simd::{LANES, load, splat};

/// Layers between the first and the colour.
pub(super) const MIDDLE: usize = 3;
/// Numbers of a colour: three, padded.
const COLOUR: usize = 4;
/// Rows of the first layer's weights: 63, padded.
const FIRST_ROWS: usize = (3 * COORDINATE).next_multiple_of(4);
const COLOUR_ROWS: usize = (WIDTH + DIRECTION).next_multiple_of(4);

const FIRST_LENGTH: usize = (FIRST_ROWS + 1) * WIDTH;
const MIDDLE_LENGTH: usize = (WIDTH + 1) * WIDTH;
const COLOUR_BEGIN: usize = FIRST_LENGTH + MIDDLE * MIDDLE_LENGTH;

/// Number of parameters, with those that pad a row or a column with zeros.
pub const PARAMETERS: usize = COLOUR_BEGIN + (COLOUR_ROWS + 1) * COLOUR;

/// Position of the weights of an input of the first layer: number `n` of coordinate `axis`.
pub(super) fn first_weights(axis: usize, n: usize) -> Range<usize> {
    row(0, 3 * n + axis)
}

pub(super) fn first_bias() -> Range<usize> {
    row(0, FIRST_ROWS)
}

/// Position of the weights of a middle layer's input; its biases are those of input 128.
pub(super) fn middle_weights(layer: usize, input: usize) -> Range<usize> {
    row(FIRST_LENGTH + layer * MIDDLE_LENGTH, input)
}

/// Position of a weight of the colour: of the hidden numbers, then of the direction's.
pub(super) fn colour_weight(input: usize, channel: usize) -> usize {
    COLOUR_BEGIN + COLOUR * input + channel
}

pub(super) fn colour_bias(channel: usize) -> usize {
    colour_weight(COLOUR_ROWS, channel)
}

fn row(begin: usize, index: usize) -> Range<usize> {
    begin + index * WIDTH..begin + (index + 1) * WIDTH
}

/// A row from 128 numbers.
pub(super) fn to_row(values: &[f32]) -> Row {
    let mut out = ZERO;
    out.as_flattened_mut().as_flattened_mut().copy_from_slice(values);
    out
}

/// The encoded coordinates of an image's pixels.
pub(super) struct Coordinates {
    /// [width] and [height].
    pub(super) sides: [Vec<[f32; COORDINATE]>; 2],
    pub(super) depth: [f32; COORDINATE],
}

impl Coordinates {
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, size: [usize; 2]) -> Self {
        Self { sides: [side(simd, size[0]), side(simd, size[1])], depth: depth(simd) }
    }
}

/// The weights of a layer and their transpose.
pub(super) struct Layer {
    pub(super) weights: Box<Weights>,
    pub(super) transposed: Box<Weights>,
    pub(super) bias: Row,
}

/// The parameters in the layout of the products, for one size of images.
///
/// A position's encoding consists of numbers of its column, of its row, and of constants. The first
/// layer's sums are therefore those of the column and of the row, added up.
pub(super) struct Network {
    /// The first layer's sums over the numbers of each column, [width].
    pub(super) columns: Vec<Row>,
    /// Over those of each row, the constants and the bias, [height].
    pub(super) rows: Vec<Row>,
    pub(super) layers: Vec<Layer>,
    /// The colour's weights of the hidden numbers, by channel.
    pub(super) colour: [Row; 3],
    /// Those of the direction's numbers.
    pub(super) direction: [[f32; 3]; DIRECTION],
    pub(super) colour_bias: [f32; 3],
}

impl Network {
    #[inline(always)]
    pub(super) fn new<S: Simd>(simd: S, parameters: &[f32], coordinates: &Coordinates) -> Self {
        let weights = |axis: usize| -> Vec<Row> {
            (0..COORDINATE).map(|n| to_row(&parameters[first_weights(axis, n)])).collect()
        };
        let bias = to_row(&parameters[first_bias()]);
        let start = combined(simd, &coordinates.depth, &weights(2), &bias);
        let [width, height] = &coordinates.sides;
        let (by_column, by_row) = (weights(0), weights(1));
        let mut columns = Vec::with_capacity(width.len());
        for numbers in width {
            columns.push(combined(simd, numbers, &by_column, &ZERO));
        }
        let mut rows = Vec::with_capacity(height.len());
        for numbers in height {
            rows.push(combined(simd, numbers, &by_row, &start));
        }
        let colour = |channel: usize| -> Row {
            let values: Vec<f32> =
                (0..WIDTH).map(|k| parameters[colour_weight(k, channel)]).collect();
            to_row(&values)
        };
        Self {
            columns,
            rows,
            layers: (0..MIDDLE).map(|n| Layer::new(parameters, n)).collect(),
            colour: [colour(0), colour(1), colour(2)],
            direction: std::array::from_fn(|n| {
                std::array::from_fn(|channel| parameters[colour_weight(WIDTH + n, channel)])
            }),
            colour_bias: std::array::from_fn(|channel| parameters[colour_bias(channel)]),
        }
    }
}

impl Layer {
    fn new(parameters: &[f32], layer: usize) -> Self {
        let zero = || Box::new([[ZERO[0]; WIDTH]; PANELS]);
        let (mut weights, mut transposed) = (zero(), zero());
        for input in 0..WIDTH {
            let row = to_row(&parameters[middle_weights(layer, input)]);
            for (panel, cell) in row.iter().enumerate() {
                weights[panel][input] = *cell;
            }
            let (panel, column) = (input / (WIDTH / PANELS), input % (WIDTH / PANELS));
            for (output, value) in numbers(&row).iter().enumerate() {
                transposed[panel][output].as_flattened_mut()[column] = *value;
            }
        }
        let bias = to_row(&parameters[middle_weights(layer, WIDTH)]);
        Self { weights, transposed, bias }
    }
}

/// `start` and the sum of rows, each times a number.
#[inline(always)]
pub(super) fn combined<S: Simd>(simd: S, by: &[f32], rows: &[Row], start: &Row) -> Row {
    let mut sums = [splat(simd, 0.0); WIDTH / LANES];
    for (sum, lanes) in sums.iter_mut().zip(vectors(start)) {
        *sum = load(simd, lanes);
    }
    for (by, row) in by.iter().zip(rows) {
        for (sum, lanes) in sums.iter_mut().zip(vectors(row)) {
            *sum = load(simd, lanes).mul_add(*by, *sum);
        }
    }
    let mut out = ZERO;
    for (lanes, sum) in out.as_flattened_mut().iter_mut().zip(sums) {
        sum.store_slice(lanes);
    }
    out
}
