//! The noise field's buffers on the device.

use fled_gpu::{Buffer, Gpu, GpuError};

use super::SEGMENTS;
use super::kernels::{AdamUniform, ChunkUniform, LayerUniform, NoiseUniform};
use super::network::{LAYERS, Network};

/// The network, its gradients and moments, and the outputs of its layers.
pub(super) struct Buffers {
    pub(super) field: Buffer<NoiseUniform>,
    pub(super) chunks: Vec<Buffer<ChunkUniform>>,
    pub(super) layers: Vec<Buffer<LayerUniform>>,
    pub(super) adam: Buffer<AdamUniform>,
    pub(super) encoded: Buffer<[f32; 4]>,
    /// Output of each layer for the pixels of a chunk; that of the last layer for all pixels.
    pub(super) outputs: Vec<Buffer<[f32; 4]>>,
    /// Derivative by each layer's output before its ReLU.
    pub(super) deltas: Vec<Buffer<[f32; 4]>>,
    pub(super) gradients: Buffer<[f32; 4]>,
    pub(super) parameters: Buffer<[f32; 4]>,
    pub(super) moments: Buffer<[f32; 4]>,
}

impl Buffers {
    pub(super) fn new(
        gpu: &Gpu,
        network: &Network,
        pixels: usize,
        chunk: usize,
    ) -> Result<Self, GpuError> {
        // Layers process 8 pixels at once and write rows past the last; a chunk ends at a multiple
        // of 8.
        let (rows, all_rows) = (chunk.next_multiple_of(8), pixels.next_multiple_of(8));
        let last = LAYERS - 1;
        let output = |layer: usize, rows: usize, all_rows: usize| {
            let rows = if layer == last { all_rows } else { rows };
            gpu.create("noise layer", rows * network.layers[layer].output_stride4)
        };
        let parameters = network.parameters();
        let layers = network.layers.iter();
        Ok(Self {
            field: gpu.create("noise field", 1)?,
            chunks: (0..pixels.div_ceil(chunk))
                .map(|_| gpu.create("noise chunk", 1))
                .collect::<Result<_, _>>()?,
            layers: layers
                .map(|shape| gpu.upload("noise layer", &[LayerUniform::new(shape, parameters)]))
                .collect::<Result<_, _>>()?,
            adam: gpu.create("noise adam", 1)?,
            encoded: gpu.create("noise encoding", rows * network.layers[0].input_stride4)?,
            outputs: (0..LAYERS).map(|l| output(l, rows, all_rows)).collect::<Result<_, _>>()?,
            deltas: (0..LAYERS).map(|l| output(l, rows, rows)).collect::<Result<_, _>>()?,
            gradients: gpu.create("noise gradients", SEGMENTS as usize * parameters)?,
            parameters: gpu.create("noise parameters", parameters)?,
            moments: gpu.create("noise moments", 2 * parameters)?,
        })
    }

    pub(super) fn input(&self, layer: usize) -> &Buffer<[f32; 4]> {
        if layer == 0 { &self.encoded } else { &self.outputs[layer - 1] }
    }
}
