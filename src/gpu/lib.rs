//! Buffers, shaders and kernels on wgpu. Knows nothing of splats; wgpu types never leave it.
//!
//! A kernel is one file `shaders/<family>/<verb>.wgsl` with the entry point `main` and its bindings
//! in group 0, numbered from 0. Every file under `shaders/` is embedded by itself; one test
//! validates all. `#import shared/grid.wgsl` inserts another file, once. The Rust module that uses
//! the kernel owns its row:
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
//! recorder.dispatch_items(&AXPY, &[&scale, &x, &out], 3)?; // one invocation an item, at least
//! recorder.dispatch(&AXPY.with(&[("ADD", 10)]), &[&scale, &x, &out], [1, 1, 1])?;
//! recorder.submit()?; // or `finish()` for a `Recording` to repeat
//! assert_eq!(out.read()?, [22.0, 44.0, 66.0]);
//! # Ok(())
//! # }
//! ```
//!
//! - Buffers are bound in the order of the table. A dispatch checks their number, the element size
//!   against the shader's (one must divide the other), and that nothing written is bound twice. The
//!   row itself is checked against the shader when the kernel is compiled (names, order, access).
//! - `kernel.with(&[("PIXELS", 8)])` replaces the value of the line `const PIXELS: u32 = 4;` (no
//!   `override`); such a constant may size arrays and workgroups.
//! - `dispatch_indirect(&kernel, &buffers, &arguments, index)` reads three u32 of a `Buffer<u32>`;
//!   the kernel that is dispatched must not bind that buffer for writing.
//! - A command sees what the commands before it wrote. `Buffer::write` comes before everything that
//!   is submitted later. `Buffer::read` waits; `start_read(n)?` ... `.wait()?` does not hold up the
//!   device.
//! - A [`Recording`] is submitted once a step; what changes (camera, step number) is written into
//!   buffers.
//! - [`Rows`] are an array that is split into buffers where the adapter binds less than all of it.
//! - An empty buffer has room for 16 bytes: take counts from a uniform, not from `arrayLength`.
//! - [`Kernel::reflect`] gives struct layouts, bindings and constants to compare with Rust in a
//!   test.
//! - Subgroup operations are there when [`AdapterInfo::subgroup`] is `Some`; a kernel that uses
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
