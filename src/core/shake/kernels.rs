//! The kernel table of the shake and the struct that its shaders read.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Kernel, read, read_write, uniform};

pub(super) const LINEARISE: Kernel = Kernel::new(
    "shake/linearise",
    &[uniform("shake"), read("response"), read("render"), read_write("light")],
);

pub(super) const BLUR: Kernel = Kernel::new(
    "shake/blur",
    &[
        uniform("shake"),
        read("taps"),
        read("response"),
        read("light"),
        read_write("blurred"),
        read_write("factor"),
    ],
);

pub(super) const SCALE: Kernel =
    Kernel::new("shake/scale", &[uniform("shake"), read("gradient"), read_write("factor")]);

pub(super) const BLUR_BACKWARD: Kernel = Kernel::new(
    "shake/blur_backward",
    &[
        uniform("shake"),
        read("taps"),
        read("response"),
        read("scaled"),
        read("render"),
        read_write("render_gradient"),
    ],
);

/// `ShakeUniform` of shaders/shared/shake.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct ShakeUniform {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) taps: u32,
    pub(super) smooth_weight: f32,
}
