//! Times of kernels by the device's own clock.

use std::cell::RefCell;
use std::sync::PoisonError;
use std::sync::mpsc;
use std::time::Duration;

use crate::profile::Profile;
use crate::{Gpu, GpuError, KernelTime};

/// The timestamps of one submission, two per dispatch.
pub(crate) struct Timer {
    /// All but the last are full.
    queries: Vec<wgpu::QuerySet>,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    names: RefCell<Vec<&'static str>>,
}

/// Most timestamps in a query set.
const MAX_QUERIES: u32 = 4096;

impl Timer {
    pub(crate) fn next(&self, name: &'static str) -> wgpu::ComputePassTimestampWrites<'_> {
        let mut names = self.names.borrow_mut();
        let first = 2 * names.len() as u32;
        names.push(name);
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries[(first / MAX_QUERIES) as usize],
            beginning_of_pass_write_index: Some(first % MAX_QUERIES),
            end_of_pass_write_index: Some(first % MAX_QUERIES + 1),
        }
    }

    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        let count = 2 * self.names.borrow().len() as u32;
        for (set, first) in self.queries.iter().zip((0..count).step_by(MAX_QUERIES as usize)) {
            let inside = (count - first).min(MAX_QUERIES);
            encoder.resolve_query_set(set, 0..inside, &self.resolved, 8 * u64::from(first));
        }
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.staging, 0, 8 * u64::from(count));
    }
}

impl Gpu {
    /// Starts timing every kernel, or stops and discards the times. Timed dispatches have separate
    /// passes and every submission waits, so a timed step is slower than the sum of its kernels.
    /// Measures nothing without timestamps on the adapter ([`crate::AdapterInfo::timestamps`]).
    pub fn profile(&self, on: bool) {
        let on = on && self.describe().timestamps;
        *self.inner.profile.lock().unwrap_or_else(PoisonError::into_inner) = on.then(Profile::new);
    }

    /// The times of each kernel since [`Gpu::profile`], the longest first.
    pub fn profiled(&self) -> Vec<(&'static str, KernelTime)> {
        let profile = self.inner.profile.lock().unwrap_or_else(PoisonError::into_inner);
        let mut times: Vec<_> =
            profile.iter().flatten().map(|(&name, &time)| (name, time)).collect();
        times.sort_by_key(|(_, time)| std::cmp::Reverse(time.total));
        times
    }

    /// A timer for a submission of this many dispatches, if profiling is on.
    pub(crate) fn timer(&self, dispatches: usize) -> Option<Timer> {
        let on = self.inner.profile.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        if !on || dispatches == 0 {
            return None;
        }
        let device = &self.inner.device;
        let bytes = 16 * dispatches as u64;
        let buffer = |usage| {
            let usage = usage | wgpu::BufferUsages::COPY_DST;
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timestamps"),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let total = 2 * dispatches as u32;
        let set = |first: u32| {
            device.create_query_set(&wgpu::QuerySetDescriptor {
                label: None,
                ty: wgpu::QueryType::Timestamp,
                count: (total - first).min(MAX_QUERIES),
            })
        };
        Some(Timer {
            queries: (0..total).step_by(MAX_QUERIES as usize).map(set).collect(),
            resolved: buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            staging: buffer(wgpu::BufferUsages::MAP_READ),
            names: RefCell::default(),
        })
    }

    /// Waits for the submission and adds its times.
    pub(crate) fn collect(&self, timer: Timer) -> Result<(), GpuError> {
        let (sender, mapped) = mpsc::channel();
        timer.staging.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone if the wait below failed.
            let _ = sender.send(result.is_ok());
        });
        self.wait()?;
        if mapped.recv() != Ok(true) {
            return Err(GpuError::DeviceLost("timestamps could not be read".to_owned()));
        }
        let view = timer
            .staging
            .get_mapped_range(..)
            .map_err(|error| GpuError::Validation(format!("timestamps: {error}")))?;
        let period = f64::from(self.inner.queue.get_timestamp_period());
        let mut profile = self.inner.profile.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(profile) = profile.as_mut() else {
            return Ok(());
        };
        for (pair, name) in view.chunks_exact(16).zip(timer.names.into_inner()) {
            let ticks: [u64; 2] = bytemuck::pod_read_unaligned(pair);
            let time =
                Duration::from_nanos((ticks[1].saturating_sub(ticks[0]) as f64 * period) as u64);
            let entry = profile.entry(name).or_default();
            entry.shortest = if entry.dispatches == 0 { time } else { entry.shortest.min(time) };
            entry.dispatches += 1;
            entry.total += time;
        }
        Ok(())
    }
}
