//! The noise field: a small network that explains what is smooth over an image and is no part of
//! the scene (black level, cast, exposure), so that the splats need not.
//!
//! ```no_run
//! # use fled_core::{camera::Camera, noise::{NoiseField, NoiseMode}};
//! # use fled_core::noise::IntersectionLimit;
//! # fn step(
//! #     gpu: &fled_gpu::Gpu, camera: &Camera, sigma: f32, limit: &IntersectionLimit<'_>,
//! # ) -> Result<(), fled_gpu::GpuError> {
//! # let buffer = || gpu.create::<f32>("image", 3 * 280 * 160);
//! # let (render, prediction, gradient) = (buffer()?, buffer()?, buffer()?);
//! // Once a round; sizes up to this one. `None` when the mode is `Off`.
//! let Some(mut field) = NoiseField::new(gpu, NoiseMode::Grid, 0, [280, 160])? else {
//!     return Ok(());
//! };
//! // Every step from `OFF_SHARE` of the round on; before, the render itself is the prediction.
//! field.begin_step(camera, sigma)?; // the camera at the size that is trained
//! let mut recorder = gpu.recorder();
//! field.record_forward(&mut recorder, &render, &prediction)?;  // prediction = render + n
//! // ... the loss of `prediction` writes `gradient`; the splats' backward takes it too ...
//! field.record_backward(&mut recorder, &gradient, limit)?;      // and one step of Adam
//! recorder.submit()?;
//! // Every hundred steps or so; waits. Warn when it says `halved`.
//! let inspection = field.inspect(&render, &prediction)?;
//! # let _ = inspection; Ok(())
//! # }
//! ```
//!
//! One step must be submitted before the next `begin_step`, which writes what the kernels read.
//! Same seed, same device: same bits. The map is never part of a delivered view.
//!
//! Differs from the paper: its point of normalised device space is taken in the frame of the camera
//! itself, where it is the same plane for every view, because the world's frame of LLFF captures
//! does not exist for cameras that turn around a scene; views differ by the direction's encoding.

mod buffers;
mod inspection;
mod intersection_limit;
mod kernels;
mod mode;
mod network;
pub mod reference;
mod state;
mod work;

use std::ops::Range;

use fled_gpu::{Buffer, DeviceType, Gpu, GpuError, Recorder};

use crate::camera::Camera;
use buffers::Buffers;
pub use inspection::{CORRELATION_LIMIT, Inspection, LEAST_GUARDED_SPREAD};
pub use intersection_limit::IntersectionLimit;
use kernels::{AdamUniform, ChunkUniform, NoiseUniform};
pub use mode::NoiseMode;
use mode::cell_side;
use network::{LAYERS, Network};
pub use state::StateError;
pub use work::NoiseWork;

/// Share of a round's steps, from the first on, without a noise field in mode `Grid`.
pub const OFF_SHARE: f64 = 0.1;

/// Largest amplitude, and the paper's only one.
const MOST: f32 = 0.1;
/// Smallest amplitude of mode `Grid`.
const LEAST: f32 = 0.02;
/// Adam's rate falls by `DECAY` every `DECAY_STEPS` steps.
const RATE: f64 = 1e-4;
const DECAY: f64 = 0.95;
const DECAY_STEPS: u64 = 100;
/// Most cells whose activations are kept at once: 2 x 3.5 KiB a cell.
const CHUNK_GRID: usize = 16_384;
const CHUNK_PAPER: usize = 4_096;
/// Parts of the cells whose weight gradients are summed apart; a GPU needs the invocations.
const SEGMENTS_ON_CPU: u32 = 1;
const SEGMENTS_ON_GPU: u32 = 16;

/// Lanes of a subgroup of the kernels that exchange what they load: lavapipe's.
const LANES: usize = 8;

/// `clamp(3 sigma, 0.02, 0.1)`: the bound of the noise of a view whose measured noise is `sigma`.
pub fn amplitude(sigma: f32) -> f32 {
    (3.0 * sigma).clamp(LEAST, MOST)
}

/// The network, its optimiser and its buffers.
pub struct NoiseField {
    mode: NoiseMode,
    network: Network,
    /// Product of the halvings of the guard.
    restraint: f32,
    step: u64,
    segments: u32,
    /// Whether the layers' kernels exchange what they load over a subgroup.
    exchanges: bool,
    chunk_cells: usize,
    most_cells: usize,
    current: NoiseUniform,
    buffers: Buffers,
}

impl NoiseField {
    /// A new field for images of at most `size` = [width, height] px; `None` in mode `Off`.
    ///
    /// # Errors
    /// A device error, out of memory above all.
    pub fn new(
        gpu: &Gpu,
        mode: NoiseMode,
        seed: u64,
        size: [usize; 2],
    ) -> Result<Option<Self>, GpuError> {
        let octaves = match mode {
            NoiseMode::Off => return Ok(None),
            NoiseMode::Grid => 8,
            NoiseMode::Paper => 10,
        };
        let network = Network::new(octaves);
        let cell = cell_side(mode) as usize;
        let most_cells = size[0].div_ceil(cell) * size[1].div_ceil(cell);
        let chunk_cells = most_cells.min(if mode == NoiseMode::Grid {
            CHUNK_GRID
        } else {
            CHUNK_PAPER
        });
        let on_cpu = gpu.describe().device_type == DeviceType::Cpu;
        let exchanges = on_cpu && gpu.describe().subgroup == Some((LANES as u32, LANES as u32));
        let segments = if on_cpu {
            SEGMENTS_ON_CPU
        } else {
            SEGMENTS_ON_GPU
        };
        let buffers = Buffers::new(gpu, &network, most_cells, chunk_cells, segments)?;
        buffers.parameters.write(bytemuck::cast_slice(
            &network.initial(seed, mode == NoiseMode::Paper),
        ))?;
        let current = NoiseUniform::default();
        let (restraint, step) = (1.0, 0);
        Ok(Some(Self {
            mode,
            network,
            restraint,
            step,
            segments,
            exchanges,
            chunk_cells,
            most_cells,
            current,
            buffers,
        }))
    }

    /// Sets the view and its noise for what is submitted next, and counts the step.
    ///
    /// # Errors
    /// [`GpuError::Validation`] when the image is larger than the field was made for; a device
    /// error.
    pub fn begin_step(&mut self, camera: &Camera, sigma: f32) -> Result<(), GpuError> {
        let bound = if self.mode == NoiseMode::Paper {
            MOST
        } else {
            amplitude(sigma)
        };
        let uniform = NoiseUniform::new(
            camera,
            self.mode,
            self.network.octaves,
            self.restraint * bound,
        );
        if uniform.cells() > self.most_cells {
            let (width, height) = (uniform.width, uniform.height);
            return Err(GpuError::Validation(format!(
                "a noise field made too small for {width}x{height}"
            )));
        }
        self.current = uniform;
        self.buffers.field.write(&[uniform])?;
        for (chunk, cells) in self.buffers.chunks.iter().zip(self.chunks()) {
            chunk.write(&[ChunkUniform::new(&cells)])?;
        }
        self.step += 1;
        Ok(())
    }

    /// Forgets the last [`NoiseField::begin_step`], whose intersections did not fit
    /// [`IntersectionLimit`]: it will be repeated.
    pub fn take_back_step(&mut self) {
        self.step = self.step.saturating_sub(1);
    }

    /// Records `prediction = render + n`; both planar [3, H, W] of the size of
    /// [`NoiseField::begin_step`].
    ///
    /// # Errors
    /// [`GpuError::Validation`] for a buffer that is shorter than the image; a device error.
    pub fn record_forward(
        &self,
        recorder: &mut Recorder,
        render: &Buffer<f32>,
        prediction: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        self.check_length(&[render, prediction])?;
        for chunk in 0..self.chunks().len() {
            self.record_network(recorder, chunk)?;
        }
        let b = &self.buffers;
        let cells = self.current.cells();
        let raw = &b.outputs[LAYERS - 1];
        recorder.dispatch_items(&kernels::ACTIVATE, &[&b.field, raw, &b.values], cells)?;
        if self.mode == NoiseMode::Grid {
            let weighted = kernels::REDUCE.with(&[("WEIGHTED", 1)]);
            recorder.dispatch_groups(&weighted, &[&b.field, &b.values, &b.mean], 1)?;
        }
        let pixels = self.current.pixels();
        recorder.dispatch_items(
            &kernels::COMPOSE,
            &[&b.field, &b.values, &b.mean, render, prediction],
            pixels,
        )
    }

    /// Records the derivative of the loss by the network's parameters from that by the prediction,
    /// and one step of Adam. Needs the forward of the same step before it.
    ///
    /// # Errors
    /// As [`NoiseField::record_forward`].
    pub fn record_backward(
        &self,
        recorder: &mut Recorder,
        gradient: &Buffer<f32>,
        limit: &IntersectionLimit<'_>,
    ) -> Result<(), GpuError> {
        self.record_gradients(recorder, gradient)?;
        let b = &self.buffers;
        let parameters = self.network.parameters();
        let rate = RATE * DECAY.powi((self.step.saturating_sub(1) / DECAY_STEPS) as i32);
        b.adam.write(&[AdamUniform::new(
            rate,
            self.step,
            self.segments,
            parameters,
            limit,
        )])?;
        recorder.dispatch_items(
            &kernels::ADAM,
            &[
                &b.adam,
                limit.counters,
                &b.gradients,
                &b.parameters,
                &b.moments,
            ],
            parameters,
        )
    }

    fn record_gradients(
        &self,
        recorder: &mut Recorder,
        gradient: &Buffer<f32>,
    ) -> Result<(), GpuError> {
        self.check_length(&[gradient])?;
        let b = &self.buffers;
        let cells = self.current.cells();
        recorder.dispatch_items(
            &kernels::GATHER,
            &[&b.field, &b.values, &b.mean, gradient, &b.cell_gradient],
            cells,
        )?;
        if self.mode == NoiseMode::Grid {
            recorder.dispatch_groups(
                &kernels::REDUCE,
                &[&b.field, &b.cell_gradient, &b.total],
                1,
            )?;
        }
        let chunks = self.chunks();
        for (chunk, cells) in chunks.iter().enumerate() {
            if chunks.len() > 1 {
                // The activations are those of the last chunk of the forward.
                self.record_network(recorder, chunk)?;
            }
            recorder.dispatch_items(
                &kernels::OUTPUT_DELTA,
                &[
                    &b.field,
                    &b.chunks[chunk],
                    &b.values,
                    &b.cell_gradient,
                    &b.total,
                    &b.deltas[LAYERS - 1],
                ],
                cells.len(),
            )?;
            self.record_layers_backward(recorder, chunk, cells.len())?;
        }
        Ok(())
    }

    /// Encoding and network for one chunk of cells.
    fn record_network(&self, recorder: &mut Recorder, chunk: usize) -> Result<(), GpuError> {
        let b = &self.buffers;
        let count = self.chunks()[chunk].len();
        let features = &b.outputs[network::FEATURE_LAYER];
        recorder.dispatch_items(
            &kernels::ENCODE,
            &[&b.field, &b.chunks[chunk], &b.encoded, features],
            count,
        )?;
        for (layer, shape) in self.network.layers.iter().enumerate() {
            let buffers: [&dyn fled_gpu::Bind; 5] = [
                &b.layers[layer],
                &b.chunks[chunk],
                b.input(layer),
                &b.parameters,
                &b.outputs[layer],
            ];
            if self.exchanges {
                let groups = count.div_ceil(16) * shape.outputs4.div_ceil(LANES);
                recorder.dispatch_groups(&kernels::LAYER_FORWARD_SUBGROUP, &buffers, groups)?;
            } else {
                let items = count.div_ceil(8) * shape.outputs4.div_ceil(2);
                recorder.dispatch_items(&kernels::LAYER_FORWARD, &buffers, items)?;
            }
        }
        Ok(())
    }

    fn record_layers_backward(
        &self,
        recorder: &mut Recorder,
        chunk: usize,
        count: usize,
    ) -> Result<(), GpuError> {
        let b = &self.buffers;
        let chunk = &b.chunks[chunk];
        for (layer, shape) in self.network.layers.iter().enumerate().rev() {
            let (uniform, input, delta) = (&b.layers[layer], b.input(layer), &b.deltas[layer]);
            let weights: [&dyn fled_gpu::Bind; 5] = [uniform, chunk, delta, input, &b.gradients];
            if self.exchanges {
                let groups = shape.inputs4.div_ceil(4) * shape.outputs4.div_ceil(LANES);
                recorder.dispatch_groups(&kernels::LAYER_WEIGHTS_SUBGROUP, &weights, groups)?;
            } else {
                let tiles =
                    self.segments as usize * shape.inputs4.div_ceil(2) * shape.outputs4.div_ceil(2);
                recorder.dispatch_items(&kernels::LAYER_WEIGHTS, &weights, tiles)?;
            }
            if layer == 0 {
                continue;
            }
            let back: [&dyn fled_gpu::Bind; 6] = [
                uniform,
                chunk,
                delta,
                &b.parameters,
                input,
                &b.deltas[layer - 1],
            ];
            if self.exchanges {
                let groups = count.div_ceil(16) * shape.inputs4.div_ceil(LANES);
                recorder.dispatch_groups(&kernels::LAYER_BACKWARD_SUBGROUP, &back, groups)?;
            } else {
                let items = count.div_ceil(8) * shape.inputs4.div_ceil(2);
                recorder.dispatch_items(&kernels::LAYER_BACKWARD, &back, items)?;
            }
        }
        Ok(())
    }

    /// Compares the map of the step that was submitted last with its render; halves the amplitude
    /// from the next step on when they are too alike. Waits for the device.
    ///
    /// # Errors
    /// A device error.
    pub fn inspect(
        &mut self,
        render: &Buffer<f32>,
        prediction: &Buffer<f32>,
    ) -> Result<Inspection, GpuError> {
        self.check_length(&[render, prediction])?;
        let values = 3 * self.current.pixels();
        let (render, prediction) = (render.start_read(values)?, prediction.start_read(values)?);
        let inspection = inspection::compare(&render.wait()?, &prediction.wait()?);
        if inspection.halved {
            self.restraint /= 2.0;
        }
        Ok(inspection)
    }

    /// The cells of each chunk.
    fn chunks(&self) -> Vec<Range<usize>> {
        let cells = self.current.cells();
        (0..cells)
            .step_by(self.chunk_cells)
            .map(|first| first..(first + self.chunk_cells).min(cells))
            .collect()
    }

    fn check_length(&self, images: &[&Buffer<f32>]) -> Result<(), GpuError> {
        let values = 3 * self.current.pixels();
        if values == 0 {
            return Err(GpuError::Validation(
                "the noise field needs `begin_step` first".to_owned(),
            ));
        }
        match images.iter().find(|image| image.len() < values) {
            Some(image) => Err(GpuError::Validation(format!(
                "noise on {values} values, buffer of {}",
                image.len()
            ))),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
