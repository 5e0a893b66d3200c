//! Buffers on the device, counted in elements.

use std::marker::PhantomData;
use std::sync::{Arc, mpsc};

use bytemuck::Pod;

use crate::groups::Identity;
use crate::tally::Reservation;
use crate::{Gpu, GpuError, Submission};

/// `len` elements of `T` on the device. Cloning shares the storage.
///
/// A buffer may be bound as storage or uniform, and read as the arguments of an indirect dispatch.
pub struct Buffer<T> {
    raw: RawBuffer,
    len: usize,
    gpu: Gpu,
    element: PhantomData<T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self { raw: self.raw.clone(), len: self.len, gpu: self.gpu.clone(), element: PhantomData }
    }
}

/// The untyped part of a buffer.
#[derive(Clone)]
pub struct RawBuffer {
    pub(crate) raw: wgpu::Buffer,
    pub(crate) label: &'static str,
    /// Bytes per element.
    pub(crate) stride: u64,
    /// Bytes in use; the allocation is never smaller than 16.
    pub(crate) bytes: u64,
    pub(crate) identity: Identity,
    _counted: Arc<Reservation>,
}

/// A buffer that a dispatch can bind: every [`Buffer`].
pub trait Bind: sealed::Sealed {}

pub(crate) mod sealed {
    pub trait Sealed {
        fn raw(&self) -> &super::RawBuffer;
    }
}

impl<T: Pod> sealed::Sealed for Buffer<T> {
    fn raw(&self) -> &RawBuffer {
        &self.raw
    }
}

impl<T: Pod> Bind for Buffer<T> {}

impl<T: Pod> Buffer<T> {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.len
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Writes elements from `offset` on, before all work submitted later.
    ///
    /// # Errors
    /// [`GpuError::Validation`] past the end or when the range is no multiple of 4 bytes; a device
    /// error.
    pub fn write_at(&self, offset: usize, values: &[T]) -> Result<(), GpuError> {
        if offset + values.len() > self.len {
            return Err(GpuError::Validation(format!(
                "write of {}..{} into `{}` of {} elements",
                offset,
                offset + values.len(),
                self.raw.label,
                self.len
            )));
        }
        let start = offset as u64 * self.raw.stride;
        self.gpu.inner.queue.write_buffer(&self.raw.raw, start, bytemuck::cast_slice(values));
        self.gpu.check()
    }

    /// Writes elements from the first on, before all work submitted later.
    ///
    /// # Errors
    /// As [`Buffer::write_at`].
    pub fn write(&self, values: &[T]) -> Result<(), GpuError> {
        self.write_at(0, values)
    }

    /// Sets every byte to zero, before all work submitted later.
    ///
    /// # Errors
    /// A device error.
    pub fn clear(&self) -> Result<(), GpuError> {
        let mut recorder = self.gpu.recorder();
        recorder.clear(self);
        recorder.submit().map(|_| ())
    }

    /// Reads all elements, after all work submitted before.
    ///
    /// # Errors
    /// A device error.
    pub fn read(&self) -> Result<Vec<T>, GpuError> {
        self.start_read(self.len)?.wait()
    }

    /// Starts copying back the first `count` elements, without blocking the device.
    ///
    /// # Errors
    /// A device error, or [`GpuError::Validation`] past the end.
    pub fn start_read(&self, count: usize) -> Result<ReadBack<T>, GpuError> {
        if count > self.len {
            return Err(GpuError::Validation(format!("read of {count} of `{}`", self.raw.label)));
        }
        let bytes = (count as u64 * self.raw.stride).next_multiple_of(4);
        let device = &self.gpu.inner.device;
        let (staging, counted) =
            self.gpu.create_raw("read back", bytes, wgpu::BufferUsages::MAP_READ)?;
        let mut encoder =
            device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: None });
        encoder.copy_buffer_to_buffer(&self.raw.raw, 0, &staging, 0, bytes);
        let submission = Submission(self.gpu.inner.queue.submit([encoder.finish()]));
        let (sender, mapped) = mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone if the read-back was dropped.
            let _ = sender.send(result.is_ok());
        });
        self.gpu.check()?;
        Ok(ReadBack {
            gpu: self.gpu.clone(),
            staging,
            submission,
            mapped,
            count,
            element: PhantomData,
            _counted: counted,
        })
    }
}

/// Elements that are being copied from the device.
pub struct ReadBack<T> {
    gpu: Gpu,
    staging: wgpu::Buffer,
    submission: Submission,
    mapped: mpsc::Receiver<bool>,
    count: usize,
    element: PhantomData<T>,
    _counted: Reservation,
}

impl<T: Pod> ReadBack<T> {
    /// Waits for the copy, but for nothing submitted after it, and returns the elements.
    ///
    /// # Errors
    /// A device error.
    pub fn wait(self) -> Result<Vec<T>, GpuError> {
        self.gpu.wait_for(&self.submission)?;
        if self.mapped.recv() != Ok(true) {
            self.gpu.check()?;
            return Err(GpuError::DeviceLost("a buffer could not be mapped".to_owned()));
        }
        let view = self
            .staging
            .get_mapped_range(..)
            .map_err(|error| GpuError::Validation(format!("mapped range: {error}")))?;
        // The mapping may be unaligned for T, so it is copied byte by byte.
        let mut values = vec![T::zeroed(); self.count];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        let count = bytes.len();
        bytes.copy_from_slice(&view[..count]);
        Ok(values)
    }
}

impl Gpu {
    /// Creates a buffer of `len` zeroed elements.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] above the adapter's binding limit, [`GpuError::OutOfMemory`].
    pub fn create<T: Pod>(&self, label: &'static str, len: usize) -> Result<Buffer<T>, GpuError> {
        let stride = size_of::<T>() as u64;
        let bytes = len as u64 * stride;
        let limit = self.describe().max_binding;
        if bytes > limit {
            return Err(GpuError::TooLarge { label: label.to_owned(), bytes, limit });
        }
        let usage = wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::UNIFORM
            | wgpu::BufferUsages::INDIRECT
            | wgpu::BufferUsages::COPY_SRC;
        let (raw, counted) = self.create_raw(label, bytes, usage)?;
        let identity = Identity::new(&self.inner.groups);
        let raw = RawBuffer { raw, label, stride, bytes, identity, _counted: Arc::new(counted) };
        Ok(Buffer { raw, len, gpu: self.clone(), element: PhantomData })
    }

    /// Creates a buffer with these elements.
    ///
    /// # Errors
    /// As [`Gpu::create`].
    pub fn upload<T: Pod>(&self, label: &'static str, values: &[T]) -> Result<Buffer<T>, GpuError> {
        let buffer = self.create(label, values.len())?;
        buffer.write(values)?;
        Ok(buffer)
    }

    fn create_raw(
        &self,
        label: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
    ) -> Result<(wgpu::Buffer, Reservation), GpuError> {
        self.check()?;
        // A binding must not be empty, and uniform structs are multiples of 16 bytes.
        let size = bytes.next_multiple_of(16).max(16);
        if self.memory().now.saturating_add(size) > self.inner.memory {
            return Err(GpuError::OutOfMemory { label: label.to_owned(), bytes });
        }
        let device = &self.inner.device;
        let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let validation = pollster::block_on(validation.pop());
        if pollster::block_on(memory.pop()).is_some() {
            return Err(GpuError::OutOfMemory { label: label.to_owned(), bytes });
        }
        match validation {
            Some(error) => Err(GpuError::Validation(format!("buffer `{label}`: {error}"))),
            None => Ok((buffer, self.inner.tally.reserve(size))),
        }
    }
}
