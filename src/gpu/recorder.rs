//! Recording: many dispatches, one compute pass, one submission.

use std::sync::Arc;

use bytemuck::Pod;

use crate::buffer::sealed::Sealed;
use crate::buffer::{Bind, Buffer, RawBuffer};
use crate::pipeline::Pipeline;
use crate::reflect::Access;
use crate::timer::Timer;
use crate::{Gpu, GpuError, Kernel, Submission};

/// Most workgroups per dimension of a dispatch, in every Vulkan driver.
pub const MAX_WORKGROUPS: u32 = 65_535;

/// Collects commands in order. Each sees the results of earlier ones.
pub struct Recorder {
    gpu: Gpu,
    commands: Vec<Command>,
}

/// A finished list of commands that can be submitted many times, for example once per step.
///
/// Buffers keep their identity: values that change between submissions are written into them.
pub struct Recording {
    gpu: Gpu,
    commands: Vec<Command>,
}

enum Command {
    Dispatch { pipeline: Arc<Pipeline>, group: wgpu::BindGroup, workgroups: Workgroups },
    Clear(RawBuffer),
    Copy { from: RawBuffer, to: RawBuffer, bytes: u64 },
}

enum Workgroups {
    Direct([u32; 3]),
    /// Three u32 at this byte offset of the buffer.
    Indirect(RawBuffer, u64),
}

impl Gpu {
    /// An empty list of commands.
    pub fn recorder(&self) -> Recorder {
        Recorder { gpu: self.clone(), commands: Vec::new() }
    }
}

impl Recorder {
    /// The device of the commands.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Adds a dispatch of `workgroups`; no dimension may exceed [`MAX_WORKGROUPS`].
    ///
    /// # Errors
    /// [`GpuError::Binding`] when the buffers do not fit the kernel, [`GpuError::Shader`].
    pub fn dispatch(
        &mut self,
        kernel: &Kernel,
        buffers: &[&dyn Bind],
        workgroups: [u32; 3],
    ) -> Result<(), GpuError> {
        if workgroups.iter().any(|&n| n > MAX_WORKGROUPS) {
            return Err(fault(kernel, format!("{workgroups:?} workgroups")));
        }
        self.push(kernel, buffers, Workgroups::Direct(workgroups))
    }

    /// Adds a dispatch of at least one invocation per item, folded into rows of at most
    /// [`MAX_WORKGROUPS`] (`flat_workgroup` of `shared/grid.wgsl` unfolds the index).
    ///
    /// # Errors
    /// As [`Recorder::dispatch`].
    pub fn dispatch_items(
        &mut self,
        kernel: &Kernel,
        buffers: &[&dyn Bind],
        items: usize,
    ) -> Result<(), GpuError> {
        let width: u32 = self.gpu.pipeline(kernel)?.reflection.workgroup.iter().product();
        self.dispatch_groups(kernel, buffers, items.div_ceil(width as usize))
    }

    /// Adds a dispatch of at least `groups` workgroups, folded like [`Recorder::dispatch_items`].
    ///
    /// # Errors
    /// As [`Recorder::dispatch`].
    pub fn dispatch_groups(
        &mut self,
        kernel: &Kernel,
        buffers: &[&dyn Bind],
        groups: usize,
    ) -> Result<(), GpuError> {
        self.dispatch(kernel, buffers, fold(groups))
    }

    /// Adds a dispatch whose three workgroup counts are at element `index` of `arguments` (u32 x
    /// 3). The kernel must not bind `arguments` for writing.
    ///
    /// # Errors
    /// As [`Recorder::dispatch`].
    pub fn dispatch_indirect(
        &mut self,
        kernel: &Kernel,
        buffers: &[&dyn Bind],
        arguments: &Buffer<u32>,
        index: usize,
    ) -> Result<(), GpuError> {
        if index + 3 > arguments.len() {
            return Err(fault(
                kernel,
                format!("indirect arguments at {index} of {}", arguments.len()),
            ));
        }
        let workgroups = Workgroups::Indirect(arguments.raw().clone(), 4 * index as u64);
        self.push(kernel, buffers, workgroups)
    }

    /// Adds a fill with zeros. Splits the compute pass: prefer a kernel within a step.
    pub fn clear<T: Pod>(&mut self, buffer: &Buffer<T>) {
        self.commands.push(Command::Clear(buffer.raw().clone()));
    }

    /// Adds a copy of the first `count` elements. Splits the compute pass.
    ///
    /// # Errors
    /// [`GpuError::Validation`] past the end of either buffer.
    pub fn copy<T: Pod>(
        &mut self,
        from: &Buffer<T>,
        to: &Buffer<T>,
        count: usize,
    ) -> Result<(), GpuError> {
        if count > from.len() || count > to.len() {
            return Err(GpuError::Validation(format!(
                "copy of {count} from {} to {}",
                from.len(),
                to.len()
            )));
        }
        let bytes = (count * size_of::<T>()) as u64;
        self.commands.push(Command::Copy { from: from.raw().clone(), to: to.raw().clone(), bytes });
        Ok(())
    }

    /// Submits the commands without waiting.
    ///
    /// # Errors
    /// A device error.
    pub fn submit(self) -> Result<Submission, GpuError> {
        self.finish().submit()
    }

    /// Finishes the list.
    pub fn finish(self) -> Recording {
        Recording { gpu: self.gpu, commands: self.commands }
    }

    fn push(
        &mut self,
        kernel: &Kernel,
        buffers: &[&dyn Bind],
        workgroups: Workgroups,
    ) -> Result<(), GpuError> {
        let pipeline = self.gpu.pipeline(kernel)?;
        let raws: Vec<_> = buffers.iter().map(|b| b.raw()).collect();
        check(&pipeline, &raws)?;
        let bound: Vec<_> = raws.iter().map(|b| (&b.identity, &b.raw)).collect();
        let inner = &self.gpu.inner;
        let group = inner.groups.group(&inner.device, &pipeline, &bound);
        self.commands.push(Command::Dispatch { pipeline, group, workgroups });
        self.gpu.check()
    }
}

impl Recording {
    /// Submits all commands once, without waiting.
    ///
    /// # Errors
    /// A device error.
    pub fn submit(&self) -> Result<Submission, GpuError> {
        let inner = &self.gpu.inner;
        self.gpu.check()?;
        let mut encoder = inner
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("recording") });
        let dispatches =
            self.commands.iter().filter(|c| matches!(c, Command::Dispatch { .. })).count();
        let timer = self.gpu.timer(dispatches);
        let mut commands = self.commands.iter().peekable();
        while let Some(command) = commands.next_if(|_| true) {
            match command {
                Command::Clear(buffer) => encoder.clear_buffer(&buffer.raw, 0, None),
                Command::Copy { from, to, bytes } => {
                    encoder.copy_buffer_to_buffer(&from.raw, 0, &to.raw, 0, *bytes);
                }
                Command::Dispatch { pipeline, group, workgroups } => {
                    let mut pass = begin(&mut encoder, timer.as_ref(), pipeline);
                    encode(&mut pass, pipeline, group, workgroups);
                    // Timed kernels have separate passes; otherwise one pass takes all that follow.
                    while timer.is_none()
                        && let Some(Command::Dispatch { pipeline, group, workgroups }) =
                            commands.next_if(|c| matches!(c, Command::Dispatch { .. }))
                    {
                        encode(&mut pass, pipeline, group, workgroups);
                    }
                }
            }
        }
        if let Some(timer) = &timer {
            timer.resolve(&mut encoder);
        }
        let submission = Submission(inner.queue.submit([encoder.finish()]));
        self.gpu.check()?;
        if let Some(timer) = timer {
            self.gpu.collect(timer)?;
        }
        Ok(submission)
    }
}

fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    timer: Option<&Timer>,
    pipeline: &Pipeline,
) -> wgpu::ComputePass<'a> {
    let timestamp_writes = timer.map(|t| t.next(pipeline.kernel.name));
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes })
}

fn encode(
    pass: &mut wgpu::ComputePass<'_>,
    pipeline: &Pipeline,
    group: &wgpu::BindGroup,
    workgroups: &Workgroups,
) {
    pass.set_pipeline(&pipeline.raw);
    pass.set_bind_group(0, group, &[]);
    match workgroups {
        Workgroups::Direct([x, y, z]) => pass.dispatch_workgroups(*x, *y, *z),
        Workgroups::Indirect(arguments, offset) => {
            pass.dispatch_workgroups_indirect(&arguments.raw, *offset);
        }
    }
}

/// `groups` workgroups in rows that every driver accepts; may be a few more than requested.
fn fold(groups: usize) -> [u32; 3] {
    let rows = groups.div_ceil(MAX_WORKGROUPS as usize).max(1);
    [groups.div_ceil(rows) as u32, rows as u32, 1]
}

fn fault(kernel: &Kernel, message: String) -> GpuError {
    GpuError::Binding { kernel: kernel.name.to_owned(), message }
}

/// Checks number, element size and aliasing of the buffers against the shader's declarations.
fn check(pipeline: &Pipeline, buffers: &[&RawBuffer]) -> Result<(), GpuError> {
    let declared = &pipeline.reflection.bindings;
    let kernel = &pipeline.kernel;
    if declared.len() != buffers.len() {
        return Err(fault(
            kernel,
            format!("{} buffers for {} bindings", buffers.len(), declared.len()),
        ));
    }
    for (i, (binding, buffer)) in declared.iter().zip(buffers).enumerate() {
        let name = &binding.name;
        let (stride, element) = (u64::from(binding.stride), buffer.stride);
        if binding.access == Access::Uniform && buffer.bytes < stride {
            let bytes = buffer.bytes;
            return Err(fault(
                kernel,
                format!("`{name}` has {stride} bytes, `{}` {bytes}", buffer.label),
            ));
        }
        if binding.access != Access::Uniform && stride % element != 0 && element % stride != 0 {
            let label = buffer.label;
            return Err(fault(
                kernel,
                format!("`{name}`: elements of {stride} bytes, `{label}` of {element}"),
            ));
        }
        let aliased = buffers.iter().zip(declared).enumerate().any(|(j, (other, d))| {
            let written = binding.access == Access::ReadWrite || d.access == Access::ReadWrite;
            i != j && written && other.raw == buffer.raw
        });
        if aliased {
            return Err(fault(
                kernel,
                format!("`{}` is bound twice, once for writing", buffer.label),
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_many_groups_for_a_dimension_are_folded_into_rows() {
        assert_eq!(fold(0), [0, 1, 1]);
        assert_eq!(fold(65_535), [65_535, 1, 1]);
        assert_eq!(fold(65_536), [32_768, 2, 1]);
        let [x, y, _] = fold(1_000_001);
        assert!(x <= MAX_WORKGROUPS && x as usize * y as usize >= 1_000_001);
    }
}
