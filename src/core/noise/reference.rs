//! The reference of the noise field in `f64`, pixel by pixel.

use glam::DVec3;

use super::AMPLITUDE;
use super::network::{self, FEATURE_LAYER, LAYERS, Network};
use crate::camera::Camera;

/// The field with fixed parameters for one view.
pub struct ReferenceNoise<'a> {
    network: Network,
    parameters: &'a [f64],
    camera: &'a Camera,
}

/// Values of one pixel's forward pass that its backward pass needs.
struct Pixel {
    /// Input of every layer.
    inputs: Vec<Vec<f64>>,
    /// Output of the network.
    raw: [f64; 3],
}

impl<'a> ReferenceNoise<'a> {
    /// `parameters` in the layout of the buffers.
    pub fn new(parameters: &'a [f64], camera: &'a Camera) -> Self {
        Self { network: Network::new(), parameters, camera }
    }

    fn pixels(&self) -> usize {
        self.camera.intrinsics.width * self.camera.intrinsics.height
    }

    /// The noise of every pixel, [3, H, W].
    pub fn map(&self) -> Vec<f64> {
        let noise: Vec<_> =
            (0..self.pixels()).map(|pixel| noise(self.forward(pixel).raw)).collect();
        (0..3).flat_map(|channel| noise.iter().map(move |n| n[channel])).collect()
    }

    /// Derivative of `sum gradient * map` by every parameter.
    pub fn gradient(&self, gradient: &[f64]) -> Vec<f64> {
        let mut result = vec![0.0; self.parameters.len()];
        for index in 0..self.pixels() {
            let pixel = self.forward(index);
            let n = noise(pixel.raw);
            let delta = std::array::from_fn(|c| {
                let slope = n[c] * (1.0 - n[c] / f64::from(AMPLITUDE));
                gradient[c * self.pixels() + index] * slope
            });
            self.backward(&pixel, delta, &mut result);
        }
        result
    }

    fn forward(&self, index: usize) -> Pixel {
        let (position, direction) = self.point(index);
        let mut inputs = vec![encode(position, network::OCTAVES)];
        for (i, layer) in self.network.layers.iter().enumerate() {
            let input = &inputs[i];
            let mut output: Vec<f64> = (0..layer.outputs)
                .map(|m| {
                    let terms =
                        (0..layer.inputs).map(|k| input[k] * self.parameters[layer.weight(k, m)]);
                    self.parameters[layer.bias(m)] + terms.sum::<f64>()
                })
                .map(|value| if layer.relu { value.max(0.0) } else { value })
                .collect();
            if i == FEATURE_LAYER {
                output.extend(encode(direction, network::DIRECTION_OCTAVES));
            }
            inputs.push(output);
        }
        let raw = inputs.pop().expect("the last layer's output");
        Pixel { inputs, raw: [raw[0], raw[1], raw[2]] }
    }

    /// Adds the derivative by every parameter, given that by one pixel's raw output.
    fn backward(&self, pixel: &Pixel, delta: [f64; 3], result: &mut [f64]) {
        let mut delta = delta.to_vec();
        for i in (0..LAYERS).rev() {
            let (layer, input) = (&self.network.layers[i], &pixel.inputs[i]);
            for (m, &d) in delta.iter().take(layer.outputs).enumerate() {
                result[layer.bias(m)] += d;
                for (k, x) in input.iter().enumerate() {
                    result[layer.weight(k, m)] += d * x;
                }
            }
            let by_input = |k: usize| -> f64 {
                (0..layer.outputs).map(|m| delta[m] * self.parameters[layer.weight(k, m)]).sum()
            };
            let open = |k: usize| !layer.input_relu || input[k] > 0.0;
            delta = (0..layer.inputs).map(|k| if open(k) { by_input(k) } else { 0.0 }).collect();
        }
    }

    /// A pixel's position on the plane of normalised device space, and its viewing direction in the
    /// world.
    fn point(&self, index: usize) -> (DVec3, DVec3) {
        let k = &self.camera.intrinsics;
        let u = (index % k.width) as f64 + 0.5;
        let v = (index / k.width) as f64 + 0.5;
        let (width, height) = (k.width as f64, k.height as f64);
        let position =
            DVec3::new(2.0 * u / width - 1.0, 2.0 * v / height - 1.0, 2.0 * 16.0 / 63.0 - 1.0);
        let ray = DVec3::new((u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0);
        (position, (self.camera.rotation().transpose() * ray).normalize())
    }
}

fn noise(raw: [f64; 3]) -> [f64; 3] {
    raw.map(|x| f64::from(AMPLITUDE) / (1.0 + (-x).exp()))
}

/// `(x, sin x, cos x, sin 2x, cos 2x, sin 4x, ...)`, three numbers each.
fn encode(x: DVec3, octaves: usize) -> Vec<f64> {
    let mut encoded = x.to_array().to_vec();
    for octave in 0..octaves {
        let scaled = x * f64::from(1_u32 << octave);
        encoded.extend(scaled.to_array().map(f64::sin));
        encoded.extend(scaled.to_array().map(f64::cos));
    }
    encoded
}

#[cfg(test)]
mod tests {
    use super::super::tests::camera;
    use super::*;
    use crate::agreement::assert_derivative;

    fn parameters(network: &Network) -> Vec<f64> {
        network.initial(5).into_iter().map(f64::from).collect()
    }

    #[test]
    fn the_gradient_matches_central_differences() {
        let camera = camera(4, 3, 0.3);
        let network = Network::new();
        let mut parameters = parameters(&network);
        let weights: Vec<f64> = (0..3 * 4 * 3).map(|i| (0.7 * i as f64).sin()).collect();
        let gradient = ReferenceNoise::new(&parameters, &camera).gradient(&weights);
        for layer in &network.layers {
            for index in [layer.weight(1, 2), layer.weight(layer.inputs - 1, 0), layer.bias(1)] {
                let at = parameters[index];
                assert_derivative(&format!("parameter {index}"), gradient[index], at, |value| {
                    parameters[index] = value;
                    let map = ReferenceNoise::new(&parameters, &camera).map();
                    map.iter().zip(&weights).map(|(n, w)| n * w).sum()
                });
                parameters[index] = at;
            }
        }
    }

    #[test]
    fn the_map_is_positive_and_bounded() {
        let parameters = parameters(&Network::new());
        let map = ReferenceNoise::new(&parameters, &camera(6, 5, 0.3)).map();
        assert!(map.iter().all(|&n| n > 0.0 && n < 0.1));
    }
}
