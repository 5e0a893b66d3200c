//! Bind groups, kept as long as all of their buffers are.
//!
//! Work that is recorded anew mostly binds the same buffers to the same kernels, so there is
//! nothing to make anew.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use crate::device::Inner;
use crate::kernel::Pipeline;
use crate::{Gpu, buffer::RawBuffer};

/// Groups by the address of their pipeline, which lives as long as the device, and the numbers of
/// their buffers.
pub(crate) type Groups = Mutex<HashMap<(usize, Vec<u64>), wgpu::BindGroup>>;

static NEXT: AtomicU64 = AtomicU64::new(0);

/// What tells an allocation from all others. With its last clone the groups of the allocation go.
#[derive(Clone)]
pub(crate) struct Identity(Arc<Owned>);

struct Owned {
    number: u64,
    device: Weak<Inner>,
}

impl Identity {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(Arc::new(Owned {
            number,
            device: Arc::downgrade(&gpu.inner),
        }))
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        if let Some(device) = self.device.upgrade() {
            let mut groups = device.groups.lock().unwrap_or_else(PoisonError::into_inner);
            groups.retain(|(_, buffers), _| !buffers.contains(&self.number));
        }
    }
}

impl Gpu {
    /// The group that binds `buffers` to a kernel, in the order of its bindings.
    pub(crate) fn group(
        &self,
        pipeline: &Arc<Pipeline>,
        buffers: &[&RawBuffer],
    ) -> wgpu::BindGroup {
        let numbers = buffers
            .iter()
            .map(|buffer| buffer.identity.0.number)
            .collect();
        let key = (Arc::as_ptr(pipeline) as usize, numbers);
        let mut groups = self
            .inner
            .groups
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let make = || {
            let entries: Vec<_> = buffers
                .iter()
                .zip(0..)
                .map(|(b, binding)| wgpu::BindGroupEntry {
                    binding,
                    resource: b.raw.as_entire_binding(),
                })
                .collect();
            self.inner
                .device
                .create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some(pipeline.kernel.name),
                    layout: &pipeline.layout,
                    entries: &entries,
                })
        };
        groups.entry(key).or_insert_with(make).clone()
    }

    /// Bind groups that are kept.
    #[cfg(test)]
    pub(crate) fn kept_groups(&self) -> usize {
        self.inner
            .groups
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .len()
    }
}
