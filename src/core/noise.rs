//! The paper's noise field: a small network that models the part of an image that is not part of
//! the scene, so that the splats need not.
//!
//! ```no_run
//! # use fled_core::{camera::Camera, noise::{IntersectionLimit, NoiseField}};
//! # fn step(
//! #     gpu: &fled_gpu::Gpu, camera: &Camera, limit: &IntersectionLimit<'_>,
//! # ) -> Result<(), fled_gpu::GpuError> {
//! # let buffer = || gpu.create::<f32>("image", 3 * 280 * 160);
//! # let (render, prediction, gradient) = (buffer()?, buffer()?, buffer()?);
//! // Once per round; for sizes up to this one.
//! let mut field = NoiseField::new(gpu, 0, [280, 160])?;
//! field.begin_step(camera)?; // at the size in training
//! let mut recorder = gpu.recorder();
//! field.record_forward(&mut recorder, &render, &prediction)?;  // prediction = render + n
//! // ... the loss of `prediction` writes `gradient`; the splats' backward takes it too ...
//! field.record_backward(&mut recorder, &gradient, limit)?;      // and one step of Adam
//! recorder.submit()?;
//! // About every hundred steps; waits. Warn if the map `follows_scene`.
//! let inspection = field.inspect(&render, &prediction)?;
//! # let _ = inspection; Ok(())
//! # }
//! ```
//!
//! Submit each step before the next `begin_step`, which writes the kernels' inputs. The result is
//! bit-identical for the same seed and device. The map is never part of a delivered view.
//!
//! Differs from the paper: its point in normalised device space is taken in the frame of the camera
//! itself, where it is the same plane for every view, because cameras that turn around a scene have
//! no common frame like LLFF captures; views differ by the direction's encoding.
//!
//! The paper does not say: how many points a pixel has and where they lie, which bound and sign the
//! noise has, and how often the rate decays. One point on a plane and noise in 0..=0.1 are those of
//! LuSh-NeRF, from which the paper's field comes; a decay every 100 steps lets 10,000 steps fall to
//! a 170th.

mod buffers;
mod inspection;
mod kernels;
mod network;
pub mod processor;
pub mod reference;
mod state;

use std::ops::Range;

use fled_gpu::{Buffer, Gpu, GpuError, Recorder};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use buffers::Buffers;
pub use inspection::{CORRELATION_LIMIT, Inspection, LEAST_SPREAD};
use kernels::{AdamUniform, ChunkUniform, NoiseUniform};
use network::{LAYERS, Network};
pub use state::StateError;

/// The noise field of a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseMode {
    /// Positive noise at every pixel, as in the paper.
    Paper,
    /// No noise field.
    Off,
}

/// The place of the step's count of intersections, and the room for them. A step that was blended
/// from only a part of them does not update the field.
pub struct IntersectionLimit<'a> {
    /// Counters of the step.
    pub counters: &'a Buffer<u32>,
    /// Index of the count of intersections among them.
    pub total_at: u32,
    /// Largest count that fits.
    pub capacity: u32,
}

/// Upper bound of the noise.
const AMPLITUDE: f32 = 0.1;
/// Adam's rate falls by `DECAY` every `DECAY_STEPS` steps.
const RATE: f64 = 1e-4;
const DECAY: f64 = 0.95;
const DECAY_STEPS: u64 = 100;
/// Most pixels whose activations are kept at once: 2 x 2.4 KiB per pixel.
const CHUNK: usize = 4_096;
/// Parts of the pixels whose weight gradients are summed separately; a GPU needs the invocations.
const SEGMENTS: u32 = 16;

/// The network, its optimiser and its buffers.
pub struct NoiseField {
    network: Network,
    step: u64,
    chunk_pixels: usize,
    most_pixels: usize,
    current: NoiseUniform,
    buffers: Buffers,
}

impl NoiseField {
    /// A new field for images of at most `size` = [width, height] px.
    ///
    /// # Errors
    /// A device error, typically out of memory.
    pub fn new(gpu: &Gpu, seed: u64, size: [usize; 2]) -> Result<Self, GpuError> {
        let network = Network::new();
        let most_pixels = size[0] * size[1];
        let chunk_pixels = most_pixels.min(CHUNK);
        let buffers = Buffers::new(gpu, &network, most_pixels, chunk_pixels)?;
        let initial = network.initial(seed);
        buffers.parameters.write(bytemuck::cast_slice(&initial))?;
        Ok(Self {
            network,
            step: 0,
            chunk_pixels,
            most_pixels,
            current: NoiseUniform::default(),
            buffers,
        })
    }

    /// Sets the view of the next submission, and counts the step.
    ///
    /// # Errors
    /// [`GpuError::Validation`] when the image is larger than the field was made for; a device
    /// error.
    pub fn begin_step(&mut self, camera: &Camera) -> Result<(), GpuError> {
        let uniform = NoiseUniform::new(camera, AMPLITUDE);
        if uniform.pixels() > self.most_pixels {
            let (width, height) = (uniform.width, uniform.height);
            return Err(GpuError::Validation(format!(
                "a noise field made too small for {width}x{height}"
            )));
        }
        self.current = uniform;
        self.buffers.field.write(&[uniform])?;
        for (chunk, pixels) in self.buffers.chunks.iter().zip(self.chunks()) {
            chunk.write(&[ChunkUniform::new(&pixels)])?;
        }
        self.step += 1;
        Ok(())
    }

    /// Undoes the last [`NoiseField::begin_step`], whose intersections exceeded the
    /// [`IntersectionLimit`] and which will be repeated.
    pub fn take_back_step(&mut self) {
        self.step = self.step.saturating_sub(1);
    }

    /// Records `prediction = render + n`; both are planar [3, H, W] of the size passed to
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
        let raw = &b.outputs[LAYERS - 1];
        recorder.dispatch_items(
            &kernels::COMPOSE,
            &[&b.field, raw, render, prediction],
            self.current.pixels(),
        )
    }

    /// Records the derivative of the loss by the network's parameters from that by the prediction,
    /// and one step of Adam. Requires the forward pass of the same step.
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
        b.adam.write(&[AdamUniform::new(rate, self.step, parameters, limit)])?;
        recorder.dispatch_items(
            &kernels::ADAM,
            &[&b.adam, limit.counters, &b.gradients, &b.parameters, &b.moments],
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
        let raw = &b.outputs[LAYERS - 1];
        let chunks = self.chunks();
        for (chunk, pixels) in chunks.iter().enumerate() {
            if chunks.len() > 1 {
                // The stored activations are those of the last chunk of the forward pass.
                self.record_network(recorder, chunk)?;
            }
            let delta = &b.deltas[LAYERS - 1];
            recorder.dispatch_items(
                &kernels::OUTPUT_DELTA,
                &[&b.field, &b.chunks[chunk], raw, gradient, delta],
                pixels.len(),
            )?;
            self.record_layers_backward(recorder, chunk, pixels.len())?;
        }
        Ok(())
    }

    /// Records encoding and network for one chunk of pixels.
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
            let items = count.div_ceil(8) * shape.outputs4.div_ceil(2);
            recorder.dispatch_items(&kernels::LAYER_FORWARD, &buffers, items)?;
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
            let tiles = SEGMENTS as usize * shape.inputs4.div_ceil(2) * shape.outputs4.div_ceil(2);
            recorder.dispatch_items(&kernels::LAYER_WEIGHTS, &weights, tiles)?;
            if layer == 0 {
                continue;
            }
            let back: [&dyn fled_gpu::Bind; 6] =
                [uniform, chunk, delta, &b.parameters, input, &b.deltas[layer - 1]];
            let items = count.div_ceil(8) * shape.inputs4.div_ceil(2);
            recorder.dispatch_items(&kernels::LAYER_BACKWARD, &back, items)?;
        }
        Ok(())
    }

    /// Compares the map of the last submitted step with its render. Waits for the device.
    ///
    /// # Errors
    /// A device error.
    pub fn inspect(
        &self,
        render: &Buffer<f32>,
        prediction: &Buffer<f32>,
    ) -> Result<Inspection, GpuError> {
        self.check_length(&[render, prediction])?;
        let values = 3 * self.current.pixels();
        let (render, prediction) = (render.start_read(values)?, prediction.start_read(values)?);
        Ok(inspection::compare(&render.wait()?, &prediction.wait()?))
    }

    /// The pixels of each chunk.
    fn chunks(&self) -> Vec<Range<usize>> {
        let pixels = self.current.pixels();
        (0..pixels)
            .step_by(self.chunk_pixels)
            .map(|first| first..(first + self.chunk_pixels).min(pixels))
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
