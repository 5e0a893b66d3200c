//! A kernel as the device runs it.

use crate::Kernel;
use crate::reflect::Reflection;

/// A compiled kernel. Made once a device and set of constants, kept by the [`Gpu`].
pub(crate) struct Pipeline {
    pub(crate) kernel: Kernel,
    pub(crate) raw: wgpu::ComputePipeline,
    pub(crate) layout: wgpu::BindGroupLayout,
    pub(crate) reflection: Reflection,
}
