//! Buffers, shaders and kernels on wgpu. Independent of splats; no wgpu type is public.
//!
//! A kernel is one file `shaders/<family>/<verb>.wgsl` with the entry point `main` and its bindings
//! in group 0, numbered from 0. Every file under `shaders/` is embedded separately, and one test
//! validates them all. `#import shared/grid.wgsl` inserts another file, once. The Rust module that
//! uses the kernel owns its row:
//!
//! ```
//! use fled_gpu::{Gpu, Kernel, read, read_write, uniform};
//!
//! const AXPY: Kernel =
//!     Kernel::new("shared/test_axpy", &[uniform("scale"), read("x"), read_write("out")]);
//!
//! #[repr(C)]
//! #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
//! struct Scale { factor: f32, count: u32 }
//!
//! # fn main() -> Result<(), fled_gpu::GpuError> {
//! let gpu = Gpu::new("auto")?;
//! let scale = gpu.upload("scale", &[Scale { factor: 2.0, count: 3 }])?;
//! let x = gpu.upload("x", &[1.0_f32, 2.0, 3.0])?;
//! let out = gpu.create::<f32>("out", 3)?;               // zeroed
//!
//! let mut recorder = gpu.recorder();                     // all dispatches share one compute pass
//! recorder.dispatch_items(&AXPY, &[&scale, &x, &out], 3)?; // at least one invocation per item
//! recorder.dispatch(&AXPY.with(&[("ADD", 10)]), &[&scale, &x, &out], [1, 1, 1])?;
//! recorder.submit()?; // or `finish()` for a `Recording` to repeat
//! assert_eq!(out.read()?, [22.0, 44.0, 66.0]);
//! # Ok(())
//! # }
//! ```
//!
//! - Buffers are bound in the order of the table. A dispatch checks their number, the element size
//!   against the shader's (one must divide the other), and that no written buffer is bound twice.
//!   The row itself is checked against the shader when the kernel is compiled (names, order,
//!   access).
//! - `kernel.with(&[("PIXELS", 8)])` replaces the value of the line `const PIXELS: u32 = 4;` (not
//!   an `override`); such a constant may size arrays and workgroups.
//! - `dispatch_indirect(&kernel, &buffers, &arguments, index)` reads three u32 of a `Buffer<u32>`;
//!   the dispatched kernel must not bind that buffer for writing.
//! - Commands see the results of earlier commands. `Buffer::write` precedes all work submitted
//!   later. `Buffer::read` waits; `start_read(n)?` ... `.wait()?` does not block the device.
//! - A [`Recording`] is submitted once per step; changing values (camera, step number) are written
//!   into buffers.
//! - [`Rows`] is an array split into several buffers if it exceeds the adapter's binding limit.
//! - An empty buffer has room for 16 bytes: take counts from a uniform, not from `arrayLength`.
//! - [`Kernel::reflect`] returns struct layouts, bindings and constants for comparisons with Rust
//!   in tests.
//! - Subgroup operations are available if [`AdapterInfo::subgroup`] is `Some`; a kernel that uses
//!   them needs a second file without. `@builtin(subgroup_invocation_id)` needs a one-dimensional
//!   workgroup.
//! - `gpu.profile(true)` ... `gpu.profiled()` times each kernel; `gpu.memory()` counts the bytes in
//!   buffers.

mod buffer;
mod compile;
mod device;
mod error;
mod groups;
mod kernel;
mod memory;
mod pipeline;
mod profile;
mod recorder;
pub mod reflect;
mod rows;
pub mod shader;
mod tally;
mod timer;

pub use buffer::{Bind, Buffer, ReadBack};
pub use device::{AdapterInfo, DeviceType, Gpu, Submission};
pub use error::GpuError;
pub use kernel::{Binding, Kernel, read, read_write, uniform};
pub use memory::MemoryUse;
pub use profile::KernelTime;
pub use recorder::{MAX_WORKGROUPS, Recorder, Recording};
pub use reflect::Access;
pub use rows::{Rows, part_sizes};

#[cfg(test)]
mod tests;
