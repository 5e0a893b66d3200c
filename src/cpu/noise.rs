//! The paper's noise field: a network of a pixel's position and direction whose output, between 0
//! and [`AMPLITUDE`], is added to the render in training. The reference is the core's
//! noise/reference.rs.
//!
//! The backward pass repeats the forward pass instead of keeping its activations: they are 2 KiB a
//! pixel, 367 MB at 560x320. A block of 64 pixels passes through all layers and back in the second
//! cache.

mod adam;
mod block;
mod encoding;
mod gradient;
mod network;
mod product;

use rayon::prelude::*;

use crate::View;
use crate::simd::vectorised;
use block::{Block, Place};
use network::{Coordinates, Network};

pub use network::PARAMETERS;

/// Upper bound of the noise.
pub const AMPLITUDE: f32 = 0.1;

/// Numbers of a field: the parameters, and the first and second moments of Adam, each in the layout
/// of the core's network.
pub const NUMBERS: usize = 3 * PARAMETERS;

/// The network and its optimiser.
#[derive(Clone, Debug)]
pub struct NoiseField {
    step: u64,
    /// [3, PARAMETERS].
    numbers: Vec<f32>,
}

impl NoiseField {
    /// A field after `step` steps with these numbers, or with moments of zero where only parameters
    /// are given. `None` for another count of numbers.
    pub fn new(step: u64, mut numbers: Vec<f32>) -> Option<Self> {
        if numbers.len() == PARAMETERS {
            numbers.resize(NUMBERS, 0.0);
        }
        (numbers.len() == NUMBERS).then_some(Self { step, numbers })
    }

    /// Steps taken.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Parameters and moments, [`NUMBERS`].
    pub fn numbers(&self) -> &[f32] {
        &self.numbers
    }

    /// Adds a view's noise to its render. Only the view's rows, focal lengths, centre and size
    /// matter. Both images are planar [3, height, width].
    ///
    /// # Panics
    /// When the render has another size.
    pub fn forward(&self, view: &View, render: &[f32], prediction: &mut Vec<f32>) {
        let [width, height] = view.size;
        let plane = width * height;
        assert_eq!(render.len(), 3 * plane, "three channels of the view's size");
        prediction.resize(3 * plane, 0.0);
        if plane == 0 {
            return;
        }
        let (network, _) = self.network(view.size);
        let (red, others) = prediction.split_at_mut(plane);
        let (green, blue) = others.split_at_mut(plane);
        let rows = red.par_chunks_mut(width).zip(green.par_chunks_mut(width));
        let rows = rows.zip(blue.par_chunks_mut(width)).enumerate();
        rows.for_each_init(Block::default, |block, (y, ((red, green), blue))| {
            let row = |channel: usize| &render[channel * plane + y * width..][..width];
            for place in Place::all(width, y) {
                let prediction = [&mut *red, &mut *green, &mut *blue];
                block.compose((&network, view), place, [row(0), row(1), row(2)], prediction);
            }
        });
    }

    /// Takes a step of Adam, given the derivative of the loss by the prediction of the same view,
    /// planar [3, height, width].
    ///
    /// # Panics
    /// When the derivative has another size.
    pub fn backward(&mut self, view: &View, by_prediction: &[f32]) {
        let gradient = self.gradient(view, by_prediction);
        self.step += 1;
        adam::step(&mut self.numbers, &gradient, self.step);
    }

    /// The derivative by the parameters alone.
    ///
    /// # Panics
    /// As [`NoiseField::backward`].
    pub fn gradient(&self, view: &View, by_prediction: &[f32]) -> Vec<f32> {
        let [width, height] = view.size;
        assert_eq!(by_prediction.len(), 3 * width * height, "three channels of the view's size");
        let (network, coordinates) = self.network(view.size);
        gradient::by_parameters(&network, &coordinates, view, by_prediction)
    }

    fn network(&self, size: [usize; 2]) -> (Network, Coordinates) {
        vectorised!(simd => {
            let coordinates = Coordinates::new(simd, size);
            (Network::new(simd, &self.numbers[..PARAMETERS], &coordinates), coordinates)
        })
    }
}
