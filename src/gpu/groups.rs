//! Bind groups, cached as long as all of their buffers live.
//!
//! New recordings mostly bind the same buffers to the same kernels, and so reuse their groups.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::pipeline::Pipeline;

/// The address of a pipeline, which lives as long as the device, and the numbers of the buffers
/// bound to it.
type Key = (usize, Vec<u64>);

/// The bind groups of one device.
#[derive(Default)]
pub(crate) struct Groups(Mutex<HashMap<Key, wgpu::BindGroup>>);

static NEXT: AtomicU64 = AtomicU64::new(0);

/// The identity of an allocation. Dropping its last clone removes the allocation's groups.
#[derive(Clone)]
pub(crate) struct Identity(Arc<Owned>);

struct Owned {
    number: u64,
    groups: Weak<Groups>,
}

impl Identity {
    /// A new identity, whose groups will be cached in `groups`.
    pub(crate) fn new(groups: &Arc<Groups>) -> Self {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        Self(Arc::new(Owned { number, groups: Arc::downgrade(groups) }))
    }
}

impl Drop for Owned {
    fn drop(&mut self) {
        if let Some(groups) = self.groups.upgrade() {
            groups.kept().retain(|(_, buffers), _| !buffers.contains(&self.number));
        }
    }
}

impl Groups {
    /// The group that binds `buffers` to a kernel, in the order of its bindings.
    pub(crate) fn group(
        &self,
        device: &wgpu::Device,
        pipeline: &Arc<Pipeline>,
        buffers: &[(&Identity, &wgpu::Buffer)],
    ) -> wgpu::BindGroup {
        let numbers = buffers.iter().map(|(identity, _)| identity.0.number);
        let key = (Arc::as_ptr(pipeline) as usize, numbers.collect());
        let make = || {
            let entries: Vec<_> = buffers
                .iter()
                .zip(0..)
                .map(|((_, buffer), binding)| wgpu::BindGroupEntry {
                    binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(pipeline.kernel.name),
                layout: &pipeline.layout,
                entries: &entries,
            })
        };
        self.kept().entry(key).or_insert_with(make).clone()
    }

    #[cfg(test)]
    pub(crate) fn len(&self) -> usize {
        self.kept().len()
    }

    fn kept(&self) -> MutexGuard<'_, HashMap<Key, wgpu::BindGroup>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
