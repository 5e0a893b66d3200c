//! A compiled kernel.

use crate::Kernel;
use crate::reflect::Reflection;

/// A compiled kernel. Created once per device and set of constants, and cached by the [`Gpu`].
pub(crate) struct Pipeline {
    pub(crate) kernel: Kernel,
    pub(crate) raw: wgpu::ComputePipeline,
    pub(crate) layout: wgpu::BindGroupLayout,
    pub(crate) reflection: Reflection,
}
