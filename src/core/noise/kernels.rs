//! The kernel table of the noise field and the structs its shaders read.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Kernel, read, read_write, uniform};

use super::network::{Layer, OCTAVES};
use super::{IntersectionLimit, SEGMENTS};
use crate::camera::Camera;

pub(super) const ENCODE: Kernel = Kernel::new(
    "noise/encode",
    &[uniform("field"), uniform("chunk"), read_write("encoded"), read_write("features")],
);

pub(super) const LAYER_FORWARD: Kernel = Kernel::new(
    "noise/layer_forward",
    &[uniform("layer"), uniform("chunk"), read("input"), read("parameters"), read_write("output")],
);

pub(super) const COMPOSE: Kernel = Kernel::new(
    "noise/compose",
    &[uniform("field"), read("raw"), read("render"), read_write("prediction")],
);

pub(super) const OUTPUT_DELTA: Kernel = Kernel::new(
    "noise/output_delta",
    &[uniform("field"), uniform("chunk"), read("raw"), read("gradient"), read_write("delta")],
);

pub(super) const LAYER_BACKWARD: Kernel = Kernel::new(
    "noise/layer_backward",
    &[
        uniform("layer"),
        uniform("chunk"),
        read("delta"),
        read("parameters"),
        read("input"),
        read_write("input_delta"),
    ],
);

pub(super) const LAYER_WEIGHTS: Kernel = Kernel::new(
    "noise/layer_weights",
    &[uniform("layer"), uniform("chunk"), read("delta"), read("input"), read_write("gradients")],
);

pub(super) const ADAM: Kernel = Kernel::new(
    "noise/adam",
    &[
        uniform("adam"),
        read("intersections"),
        read("gradients"),
        read_write("parameters"),
        read_write("moments"),
    ],
);

/// `NoiseUniform` of shaders/shared/noise.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct NoiseUniform {
    pub(super) row_x: [f32; 4],
    pub(super) row_y: [f32; 4],
    pub(super) row_z: [f32; 4],
    pub(super) focal: [f32; 2],
    pub(super) centre: [f32; 2],
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) amplitude: f32,
    pub(super) octaves: u32,
}

impl NoiseUniform {
    pub(super) fn new(camera: &Camera, amplitude: f32) -> Self {
        let rows = camera.world_to_camera.transpose();
        let row = |v: glam::DVec4| [v.x as f32, v.y as f32, v.z as f32, 0.0];
        let k = &camera.intrinsics;
        Self {
            row_x: row(rows.x_axis),
            row_y: row(rows.y_axis),
            row_z: row(rows.z_axis),
            focal: [k.fx as f32, k.fy as f32],
            centre: [k.cx as f32, k.cy as f32],
            width: k.width as u32,
            height: k.height as u32,
            amplitude,
            octaves: OCTAVES as u32,
        }
    }

    pub(super) fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// `ChunkUniform` of shaders/shared/noise.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct ChunkUniform {
    pub(super) first: u32,
    pub(super) count: u32,
    pub(super) padding: [u32; 2],
}

impl ChunkUniform {
    pub(super) fn new(pixels: &Range<usize>) -> Self {
        Self { first: pixels.start as u32, count: pixels.len() as u32, padding: [0; 2] }
    }
}

/// `LayerUniform` of shaders/shared/noise.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct LayerUniform {
    pub(super) inputs: u32,
    pub(super) outputs: u32,
    pub(super) input_stride: u32,
    pub(super) output_stride: u32,
    pub(super) weights: u32,
    pub(super) biases: u32,
    pub(super) relu: u32,
    pub(super) input_relu: u32,
    pub(super) whole: u32,
    pub(super) segments: u32,
    pub(super) parameters: u32,
    pub(super) padding: u32,
}

impl LayerUniform {
    pub(super) fn new(layer: &Layer, parameters: usize) -> Self {
        Self {
            inputs: layer.inputs4 as u32,
            outputs: layer.outputs4 as u32,
            input_stride: layer.input_stride4 as u32,
            output_stride: layer.output_stride4 as u32,
            weights: layer.weights4 as u32,
            biases: layer.biases4 as u32,
            relu: u32::from(layer.relu),
            input_relu: u32::from(layer.input_relu),
            whole: u32::from(layer.whole),
            segments: SEGMENTS,
            parameters: parameters as u32,
            padding: 0,
        }
    }
}

/// `AdamUniform` of shaders/noise/adam.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct AdamUniform {
    pub(super) rate: f32,
    pub(super) correction_1: f32,
    pub(super) correction_2: f32,
    pub(super) segments: u32,
    pub(super) parameters: u32,
    pub(super) total_at: u32,
    pub(super) capacity: u32,
    pub(super) padding: u32,
}

impl AdamUniform {
    pub(super) fn new(
        rate: f64,
        step: u64,
        parameters: usize,
        limit: &IntersectionLimit<'_>,
    ) -> Self {
        let correction = |beta: f64| (1.0 - beta.powf(step as f64)) as f32;
        Self {
            rate: rate as f32,
            correction_1: correction(0.9),
            correction_2: correction(0.999),
            segments: SEGMENTS,
            parameters: parameters as u32,
            total_at: limit.total_at,
            capacity: limit.capacity,
            padding: 0,
        }
    }
}
