//! The noise field in `f64`, cell by cell: what the kernels mean.

use glam::DVec3;

use super::MOST;
use super::mode::{NoiseMode, PENALTY, cell_side};
use super::network::{self, FEATURE_LAYER, LAYERS, Network};
use crate::camera::Camera;

/// The field at fixed parameters for one view.
pub struct ReferenceNoise<'a> {
    network: Network,
    parameters: &'a [f64],
    camera: &'a Camera,
    grid: bool,
    amplitude: f64,
    cell: usize,
    columns: usize,
    rows: usize,
}

/// What the forward of one cell leaves for its backward.
struct Cell {
    /// Input of every layer.
    inputs: Vec<Vec<f64>>,
    /// Output of the network.
    raw: [f64; 3],
}

impl<'a> ReferenceNoise<'a> {
    /// `parameters` in the layout of the buffers; `amplitude` counts in mode `Grid` only.
    pub fn new(mode: NoiseMode, parameters: &'a [f64], camera: &'a Camera, amplitude: f64) -> Self {
        let grid = mode == NoiseMode::Grid;
        let cell = cell_side(mode) as usize;
        let k = &camera.intrinsics;
        Self {
            network: Network::new(if grid { 8 } else { 10 }),
            parameters,
            camera,
            grid,
            amplitude: if grid { amplitude } else { f64::from(MOST) },
            cell,
            columns: k.width.div_ceil(cell),
            rows: k.height.div_ceil(cell),
        }
    }

    /// The noise of every pixel, [3, H, W].
    pub fn map(&self) -> Vec<f64> {
        let cells: Vec<_> = (0..self.columns * self.rows)
            .map(|i| self.noise(self.forward(i).raw))
            .collect();
        let mean = self.mean(&cells);
        let (width, height) = (self.camera.intrinsics.width, self.camera.intrinsics.height);
        let mut map = vec![0.0; 3 * width * height];
        for (index, cell, weight) in self.weights() {
            for channel in 0..3 {
                map[channel * width * height + index] +=
                    weight * (cells[cell][channel] - mean[channel]);
            }
        }
        map
    }

    /// Penalty on the size of the noise: `0.01 mean(n^2)` over the cells in mode `Grid`.
    pub fn penalty(&self) -> f64 {
        let cells: Vec<_> = (0..self.columns * self.rows)
            .map(|i| self.noise(self.forward(i).raw))
            .collect();
        let mean = self.mean(&cells);
        let squares: f64 = cells
            .iter()
            .flat_map(|n| (0..3).map(|c| (n[c] - mean[c]).powi(2)))
            .sum();
        if self.grid {
            PENALTY * squares / (3 * cells.len()) as f64
        } else {
            0.0
        }
    }

    /// Derivative of `sum gradient * map + penalty` by every parameter.
    pub fn gradient(&self, gradient: &[f64]) -> Vec<f64> {
        let forward: Vec<Cell> = (0..self.columns * self.rows)
            .map(|i| self.forward(i))
            .collect();
        let cells: Vec<_> = forward.iter().map(|cell| self.noise(cell.raw)).collect();
        let by_noise = self.by_noise(&cells, gradient);
        let mut result = vec![0.0; self.parameters.len()];
        for ((cell, n), by) in forward.iter().zip(&cells).zip(&by_noise) {
            let slope = |n: f64| {
                if self.grid {
                    self.amplitude - n * n / self.amplitude
                } else {
                    n * (1.0 - n / self.amplitude)
                }
            };
            self.backward(
                cell,
                std::array::from_fn(|c| by[c] * slope(n[c])),
                &mut result,
            );
        }
        result
    }

    /// Derivative by the noise of each cell before its mean is removed.
    fn by_noise(&self, cells: &[[f64; 3]], gradient: &[f64]) -> Vec<[f64; 3]> {
        let pixels = gradient.len() / 3;
        let mean = self.mean(cells);
        let mut by = vec![[0.0; 3]; cells.len()];
        let mut share = vec![0.0; cells.len()];
        for (index, cell, weight) in self.weights() {
            share[cell] += weight / pixels as f64;
            for channel in 0..3 {
                by[cell][channel] += weight * gradient[channel * pixels + index];
            }
        }
        if !self.grid {
            return by;
        }
        let factor = 2.0 * PENALTY / (3 * cells.len()) as f64;
        for channel in 0..3 {
            for (by, n) in by.iter_mut().zip(cells) {
                by[channel] += factor * (n[channel] - mean[channel]);
            }
            let total: f64 = by.iter().map(|by| by[channel]).sum();
            for (by, share) in by.iter_mut().zip(&share) {
                by[channel] -= share * total;
            }
        }
        by
    }

    /// Mean of the map of cells over the image; 0 in mode `Paper`, where nothing is removed.
    fn mean(&self, cells: &[[f64; 3]]) -> [f64; 3] {
        let pixels = (self.camera.intrinsics.width * self.camera.intrinsics.height) as f64;
        let mut mean = [0.0; 3];
        if self.grid {
            for (_, cell, weight) in self.weights() {
                for channel in 0..3 {
                    mean[channel] += weight * cells[cell][channel] / pixels;
                }
            }
        }
        mean
    }

    /// Every pixel, each of the up to four cells around it, and the cell's bilinear weight.
    fn weights(&self) -> Vec<(usize, usize, f64)> {
        let (width, height) = (self.camera.intrinsics.width, self.camera.intrinsics.height);
        let axis = |pixel: usize, cells: usize| -> [(usize, f64); 2] {
            let at = ((pixel as f64 + 0.5) / self.cell as f64 - 0.5).clamp(0.0, (cells - 1) as f64);
            let first = at.floor() as usize;
            [
                (first, 1.0 - at.fract()),
                ((first + 1).min(cells - 1), at.fract()),
            ]
        };
        let mut weights = Vec::new();
        for y in 0..height {
            for x in 0..width {
                for (row, vertical) in axis(y, self.rows) {
                    for (column, horizontal) in axis(x, self.columns) {
                        weights.push((
                            y * width + x,
                            row * self.columns + column,
                            vertical * horizontal,
                        ));
                    }
                }
            }
        }
        weights
    }

    fn noise(&self, raw: [f64; 3]) -> [f64; 3] {
        raw.map(|x| {
            self.amplitude
                * if self.grid {
                    x.tanh()
                } else {
                    1.0 / (1.0 + (-x).exp())
                }
        })
    }

    fn forward(&self, cell: usize) -> Cell {
        let (position, direction) = self.point(cell);
        let mut inputs = vec![encode(position, self.network.octaves)];
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
        Cell {
            inputs,
            raw: [raw[0], raw[1], raw[2]],
        }
    }

    /// Adds the derivative by every parameter, given that by the raw output of one cell.
    fn backward(&self, cell: &Cell, delta: [f64; 3], result: &mut [f64]) {
        let mut delta = delta.to_vec();
        for i in (0..LAYERS).rev() {
            let (layer, input) = (&self.network.layers[i], &cell.inputs[i]);
            for (m, &d) in delta.iter().take(layer.outputs).enumerate() {
                result[layer.bias(m)] += d;
                for (k, x) in input.iter().enumerate() {
                    result[layer.weight(k, m)] += d * x;
                }
            }
            let by_input = |k: usize| -> f64 {
                (0..layer.outputs)
                    .map(|m| delta[m] * self.parameters[layer.weight(k, m)])
                    .sum()
            };
            let open = |k: usize| !layer.input_relu || input[k] > 0.0;
            delta = (0..layer.inputs)
                .map(|k| if open(k) { by_input(k) } else { 0.0 })
                .collect();
        }
    }

    /// Position on the plane of normalised device space, and viewing direction in the world, of a
    /// cell.
    fn point(&self, cell: usize) -> (DVec3, DVec3) {
        let k = &self.camera.intrinsics;
        let u = ((cell % self.columns) as f64 + 0.5) * self.cell as f64;
        let v = ((cell / self.columns) as f64 + 0.5) * self.cell as f64;
        let (width, height) = (k.width as f64, k.height as f64);
        let position = DVec3::new(
            2.0 * u / width - 1.0,
            2.0 * v / height - 1.0,
            2.0 * 16.0 / 63.0 - 1.0,
        );
        let ray = DVec3::new((u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0);
        (
            position,
            (self.camera.rotation().transpose() * ray).normalize(),
        )
    }
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

    #[test]
    fn the_gradient_equals_central_differences_in_both_modes() {
        for (mode, octaves) in [(NoiseMode::Grid, 8), (NoiseMode::Paper, 10)] {
            let camera = if mode == NoiseMode::Grid {
                camera(19, 13, 0.3)
            } else {
                camera(4, 3, 0.3)
            };
            let network = Network::new(octaves);
            let mut parameters: Vec<f64> = network
                .initial(5, true)
                .into_iter()
                .map(f64::from)
                .collect();
            let pixels = camera.intrinsics.width * camera.intrinsics.height;
            let weights: Vec<f64> = (0..3 * pixels).map(|i| (0.7 * i as f64).sin()).collect();
            let gradient = ReferenceNoise::new(mode, &parameters, &camera, 0.07).gradient(&weights);
            for layer in &network.layers {
                for index in [
                    layer.weight(1, 2),
                    layer.weight(layer.inputs - 1, 0),
                    layer.bias(1),
                ] {
                    let at = parameters[index];
                    assert_derivative(
                        &format!("{mode:?} parameter {index}"),
                        gradient[index],
                        at,
                        |value| {
                            parameters[index] = value;
                            let field = ReferenceNoise::new(mode, &parameters, &camera, 0.07);
                            let sum: f64 =
                                field.map().iter().zip(&weights).map(|(n, w)| n * w).sum();
                            sum + field.penalty()
                        },
                    );
                    parameters[index] = at;
                }
            }
        }
    }

    #[test]
    fn the_grid_s_map_has_no_mean_and_the_paper_s_is_positive() {
        let grid = Network::new(8)
            .initial(5, true)
            .into_iter()
            .map(f64::from)
            .collect::<Vec<_>>();
        let view = camera(37, 21, 0.3);
        let map = ReferenceNoise::new(NoiseMode::Grid, &grid, &view, 0.07).map();
        for plane in map.chunks(37 * 21) {
            assert!(plane.iter().sum::<f64>().abs() < 1e-9);
            assert!(plane.iter().any(|n| n.abs() > 1e-5));
        }
        let paper = Network::new(10)
            .initial(5, true)
            .into_iter()
            .map(f64::from)
            .collect::<Vec<_>>();
        let map = ReferenceNoise::new(NoiseMode::Paper, &paper, &camera(6, 5, 0.3), 0.0).map();
        assert!(map.iter().all(|&n| n > 0.0 && n < 0.1));
    }
}
