//! Forward and backward passes of the network for a few pixels of a row.

use fearless_simd::prelude::*;

use super::AMPLITUDE;
use super::encoding::{DIRECTION, direction};
use super::gradient::Gradient;
use super::network::{MIDDLE, Network};
use super::product::{Gate, Matrix, PANELS, Product, ZERO, add_by_weights, add_row};
use crate::View;
use crate::simd::{F, LANES, Lanes, load, load_some, sigmoid, splat, store_some, sum, vectorised};

/// Pixels of a block. Its activations and the weights lie in the second cache.
pub(super) const PIXELS: usize = 64;

/// Position of a block: `count` pixels of row `y` from `x`.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) count: usize,
}

impl Place {
    /// The blocks of a row of pixels.
    pub(super) fn all(width: usize, y: usize) -> impl Iterator<Item = Self> {
        (0..width).step_by(PIXELS).map(move |x| Self { x, y, count: PIXELS.min(width - x) })
    }

    /// Its values in a row of the image.
    fn of<'a>(&self, row: &'a [f32]) -> &'a [f32] {
        &row[self.x..self.x + self.count]
    }
}

/// The numbers of a block.
pub(super) struct Block {
    /// Outputs of the hidden layers.
    hidden: Vec<Matrix<PIXELS>>,
    /// Derivatives by the outputs of two layers before their ReLU.
    deltas: [Box<Matrix<PIXELS>>; 2],
    directions: [[Lanes; DIRECTION]; PIXELS / LANES],
    /// By channel: the colour's output, then the derivative by it.
    colour: [[Lanes; PIXELS / LANES]; 3],
}

impl Default for Block {
    fn default() -> Self {
        let zero = [[ZERO[0]; PIXELS]; PANELS];
        Self {
            hidden: vec![zero; MIDDLE + 1],
            deltas: [Box::new(zero), Box::new(zero)],
            directions: [[[0.0; LANES]; DIRECTION]; PIXELS / LANES],
            colour: [[[0.0; LANES]; PIXELS / LANES]; 3],
        }
    }
}

impl Block {
    /// Writes render + noise, given the rows of each channel.
    pub(super) fn compose(
        &mut self,
        (network, view): (&Network, &View),
        place: Place,
        render: [&[f32]; 3],
        prediction: [&mut [f32]; 3],
    ) {
        vectorised!(simd => {
            self.forward(simd, (network, view), place);
            for (channel, out) in prediction.into_iter().enumerate() {
                let out = &mut out[place.x..place.x + place.count];
                let groups = out.chunks_mut(LANES).zip(place.of(render[channel]).chunks(LANES));
                for (group, (out, render)) in groups.enumerate() {
                    let share = sigmoid(load(simd, &self.colour[channel][group]));
                    store_some(share.mul_add(AMPLITUDE, load_some(simd, render)), out);
                }
            }
        });
    }

    /// Adds the derivatives by the parameters, given those by the prediction, rows of each channel.
    pub(super) fn add_gradient(
        &mut self,
        (network, view): (&Network, &View),
        place: Place,
        by_prediction: [&[f32]; 3],
        gradient: &mut Gradient,
    ) {
        vectorised!(simd => {
            self.forward(simd, (network, view), place);
            for (colour, by) in self.colour.iter_mut().zip(by_prediction) {
                // Pixels beyond the row have no derivative.
                let by = place.of(by).chunks(LANES).chain(std::iter::repeat(&[][..]));
                for (colour, by) in colour.iter_mut().zip(by) {
                    let share = sigmoid(load(simd, colour));
                    let slope = share * (splat(simd, 1.0) - share) * AMPLITUDE;
                    (load_some(simd, by) * slope).store_slice(colour);
                }
            }
            self.backward(simd, network, place, gradient);
        });
    }

    #[inline(always)]
    fn forward<S: Simd>(&mut self, simd: S, (network, view): (&Network, &View), place: Place) {
        let row = &network.rows[place.y];
        for (pixel, column) in network.columns[place.x..][..place.count].iter().enumerate() {
            for panel in 0..PANELS {
                let out = &mut self.hidden[0][panel][pixel];
                for (out, (a, b)) in out.iter_mut().zip(column[panel].iter().zip(&row[panel])) {
                    (load(simd, a) + load(simd, b)).max(0.0).store_slice(out);
                }
            }
        }
        for (n, layer) in network.layers.iter().enumerate() {
            let [rows, out] = &mut self.hidden[n..n + 2] else { unreachable!("a layer more") };
            let (weights, start) = (&layer.weights, &layer.bias);
            Product { rows, weights, start, gate: Gate::Relu }.run(simd, place.count, out);
        }
        self.forward_colour(simd, (network, view), place);
    }

    #[inline(always)]
    fn forward_colour<S: Simd>(
        &mut self,
        simd: S,
        (network, view): (&Network, &View),
        place: Place,
    ) {
        let hidden = &self.hidden[MIDDLE];
        for pixel in 0..place.count {
            let mut sums = [splat(simd, 0.0); 3];
            for (panel, hidden) in hidden.iter().enumerate() {
                for (vector, hidden) in hidden[pixel].iter().enumerate() {
                    let hidden = load(simd, hidden);
                    for (sum, weights) in sums.iter_mut().zip(&network.colour) {
                        *sum = hidden.mul_add(load(simd, &weights[panel][vector]), *sum);
                    }
                }
            }
            for (colour, sums) in self.colour.iter_mut().zip(sums) {
                colour.as_flattened_mut()[pixel] = sum(sums);
            }
        }
        for (group, directions) in self.directions.iter_mut().enumerate() {
            direction(simd, view, [place.x + group * LANES, place.y], directions);
            for channel in 0..3 {
                let colour = &mut self.colour[channel][group];
                let mut value = load(simd, colour) + network.colour_bias[channel];
                for (n, weights) in network.direction.iter().enumerate() {
                    value = load(simd, &directions[n]).mul_add(weights[channel], value);
                }
                value.store_slice(colour);
            }
        }
    }

    /// From the derivative by the colour's output.
    #[inline(always)]
    fn backward<S: Simd>(
        &mut self,
        simd: S,
        network: &Network,
        place: Place,
        gradient: &mut Gradient,
    ) {
        self.backward_colour(simd, network, place.count, gradient);
        for (n, layer) in network.layers.iter().enumerate().rev() {
            let [delta, other] = &mut self.deltas;
            let hidden = &self.hidden[n];
            add_by_weights(simd, hidden, delta, place.count, &mut gradient.weights[n]);
            for pixel in 0..place.count {
                add_row(simd, delta, pixel, &mut gradient.biases[n]);
            }
            let (weights, gate) = (&layer.transposed, Gate::By(hidden));
            Product { rows: delta, weights, start: &ZERO, gate }.run(simd, place.count, other);
            self.deltas.swap(0, 1);
        }
        let row = &mut gradient.rows[place.y - gradient.top];
        for (pixel, column) in gradient.columns.iter_mut().enumerate().take(place.count) {
            add_row(simd, &self.deltas[0], pixel, column);
            add_row(simd, &self.deltas[0], pixel, row);
        }
    }

    #[inline(always)]
    fn backward_colour<S: Simd>(
        &mut self,
        simd: S,
        network: &Network,
        count: usize,
        gradient: &mut Gradient,
    ) {
        for (group, directions) in self.directions.iter().enumerate() {
            for channel in 0..3 {
                let by = load(simd, &self.colour[channel][group]);
                add(simd, &mut gradient.colour_bias[channel], by);
                for (n, sums) in gradient.direction.iter_mut().enumerate() {
                    let lanes = &mut sums[channel];
                    let sum = load(simd, &directions[n]).mul_add(by, load(simd, lanes));
                    sum.store_slice(lanes);
                }
            }
        }
        for (panel, (hidden, delta)) in
            self.hidden[MIDDLE].iter().zip(self.deltas[0].iter_mut()).enumerate()
        {
            for vector in 0..hidden[0].len() {
                let (mut sums, mut weights) = ([splat(simd, 0.0); 3], [splat(simd, 0.0); 3]);
                for channel in 0..3 {
                    sums[channel] = load(simd, &gradient.colour[channel][panel][vector]);
                    weights[channel] = load(simd, &network.colour[channel][panel][vector]);
                }
                for pixel in 0..count {
                    let value = load(simd, &hidden[pixel][vector]);
                    let mut by = splat(simd, 0.0);
                    for channel in 0..3 {
                        let colour = splat(simd, self.colour[channel].as_flattened()[pixel]);
                        sums[channel] = value.mul_add(colour, sums[channel]);
                        by = weights[channel].mul_add(colour, by);
                    }
                    let by = value.simd_gt(0.0).select(by, splat(simd, 0.0));
                    by.store_slice(&mut delta[pixel][vector]);
                }
                for (out, sum) in gradient.colour.iter_mut().zip(sums) {
                    sum.store_slice(&mut out[panel][vector]);
                }
            }
        }
    }
}

#[inline(always)]
fn add<S: Simd>(simd: S, lanes: &mut Lanes, value: F<S>) {
    (load(simd, lanes) + value).store_slice(lanes);
}
