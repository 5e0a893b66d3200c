//! The shape of the network, the layout of its parameters, and their initial values.
//!
//! The paper has "a 4-layer MLP with 128 hidden units per layer and an additional noise color
//! output layer" of position x and direction d. The paper does not say: how x and d are encoded,
//! where d enters, and the activations. These are as in NeRF: octaves of sines, d beside the
//! features that the colour is made of, ReLU. LuSh-NeRF's noise field, from which the paper's
//! comes, has two more layers between features and colour, as NeRF itself.

use rand::{RngExt, SeedableRng};

/// Fully connected layers: four of 128 and one to RGB.
pub(super) const LAYERS: usize = 5;
/// The layer whose output is concatenated with the direction's encoding.
pub(super) const FEATURE_LAYER: usize = 3;
/// Width of the hidden layers.
pub(super) const HIDDEN: usize = 128;
/// Octaves of the position's encoding.
pub(super) const OCTAVES: usize = 10;
/// Octaves of the direction's encoding.
pub(super) const DIRECTION_OCTAVES: usize = 4;

/// One layer. Sizes and offsets that end in 4 count vec4s; weights are laid out [input][output],
/// both padded to a multiple of 4 with zeros that stay zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Layer {
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) inputs4: usize,
    pub(super) outputs4: usize,
    pub(super) input_stride4: usize,
    pub(super) output_stride4: usize,
    pub(super) weights4: usize,
    pub(super) biases4: usize,
    pub(super) relu: bool,
    pub(super) input_relu: bool,
    /// Whether its output is kept for all pixels, not just for a chunk.
    pub(super) whole: bool,
}

impl Layer {
    /// Index of a weight among all parameters, in floats.
    pub(super) fn weight(&self, input: usize, output: usize) -> usize {
        4 * (self.weights4 + input * self.outputs4) + output
    }

    /// Index of a bias among all parameters, in floats.
    pub(super) fn bias(&self, output: usize) -> usize {
        4 * self.biases4 + output
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Network {
    pub(super) layers: Vec<Layer>,
}

/// Numbers in an encoded 3-vector.
pub(super) fn encoding(octaves: usize) -> usize {
    3 + 6 * octaves
}

impl Network {
    pub(super) fn new() -> Self {
        let features = HIDDEN + encoding(DIRECTION_OCTAVES);
        let shapes = [
            (encoding(OCTAVES), HIDDEN),
            (HIDDEN, HIDDEN),
            (HIDDEN, HIDDEN),
            (HIDDEN, HIDDEN),
            (features, 3),
        ];
        let mut end = 0;
        let layers = shapes.iter().enumerate().map(|(i, &(inputs, outputs))| {
            let (inputs4, outputs4) = (inputs.div_ceil(4), outputs.div_ceil(4));
            let weights4 = end;
            let biases4 = weights4 + 4 * inputs4 * outputs4;
            end = biases4 + outputs4;
            Layer {
                inputs,
                outputs,
                inputs4,
                outputs4,
                input_stride4: inputs4,
                output_stride4: if i == FEATURE_LAYER { features.div_ceil(4) } else { outputs4 },
                weights4,
                biases4,
                relu: i != LAYERS - 1,
                input_relu: i != 0,
                whole: i == LAYERS - 1,
            }
        });
        Self { layers: layers.collect() }
    }

    /// Number of vec4s of all parameters.
    pub(super) fn parameters(&self) -> usize {
        self.layers.last().map_or(0, |last| last.biases4 + last.outputs4)
    }

    /// Weights and biases uniform in +-1/sqrt(inputs), [4 parameters].
    pub(super) fn initial(&self, seed: u64) -> Vec<f32> {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed ^ 0x006e_6f69_7365);
        let mut parameters = vec![0.0; 4 * self.parameters()];
        for layer in &self.layers {
            let bound = 1.0 / (layer.inputs as f32).sqrt();
            for output in 0..layer.outputs {
                for input in 0..layer.inputs {
                    parameters[layer.weight(input, output)] = random.random_range(-bound..bound);
                }
                parameters[layer.bias(output)] = random.random_range(-bound..bound);
            }
        }
        parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_network_has_four_layers_of_128_and_a_colour_layer() {
        let network = Network::new();
        let outputs: Vec<_> = network.layers.iter().map(|layer| layer.outputs).collect();
        assert_eq!(outputs, [128, 128, 128, 128, 3]);
        assert_eq!(
            network.layers.iter().map(|l| (l.inputs + 1) * l.outputs).sum::<usize>(),
            58_196
        );
        let filled = network.initial(3).iter().filter(|&&p| p != 0.0).count();
        assert!((58_187..=58_196).contains(&filled), "{filled}");
    }

    #[test]
    fn equal_seeds_give_equal_parameters_and_others_do_not() {
        let network = Network::new();
        assert_eq!(network.initial(1), network.initial(1));
        assert_ne!(network.initial(1), network.initial(2));
    }
}
