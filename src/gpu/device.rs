//! The device of a process.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::groups::Groups;
use crate::pipeline::Pipeline;
use crate::profile::Profile;
use crate::tally::Tally;
use crate::{GpuError, Kernel};

/// Longest wait for the device: far above any step, yet short enough for a hung driver.
const TIMEOUT: Duration = Duration::from_secs(300);

/// The graphics APIs whose adapters are listed, and their names in messages. Vulkan comes first: no
/// other has run the kernels.
#[cfg(not(any(windows, target_vendor = "apple")))]
const APIS: (wgpu::Backends, &str) = (wgpu::Backends::VULKAN, "Vulkan");
#[cfg(windows)]
const APIS: (wgpu::Backends, &str) =
    (wgpu::Backends::VULKAN.union(wgpu::Backends::DX12), "Vulkan or Direct3D 12");
#[cfg(target_vendor = "apple")]
const APIS: (wgpu::Backends, &str) = (wgpu::Backends::METAL, "Metal");

/// A handle of the device. Clones are cheap and share everything.
#[derive(Clone)]
pub struct Gpu {
    pub(crate) inner: Arc<Inner>,
}

pub(crate) struct Inner {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    info: AdapterInfo,
    /// The first fault that no call could return immediately.
    fault: Arc<Mutex<Option<GpuError>>>,
    pub(crate) pipelines: Mutex<HashMap<Kernel, Arc<Pipeline>>>,
    pub(crate) groups: Arc<Groups>,
    pub(crate) profile: Mutex<Option<Profile>>,
    pub(crate) tally: Arc<Tally>,
    /// Most bytes in buffers.
    pub(crate) memory: u64,
}

/// The device and its capabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct AdapterInfo {
    /// Name of the device.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// The graphics API, such as `vulkan`.
    pub backend: String,
    /// Kind of hardware.
    pub device_type: DeviceType,
    /// Smallest and largest number of invocations in a subgroup; `None` without support for
    /// subgroups.
    pub subgroup: Option<(u32, u32)>,
    /// Bytes of its own memory; `None` if it shares the processor's, or if that is unknown.
    pub own_memory: Option<u64>,
    /// Largest storage binding, bytes.
    pub max_binding: u64,
    /// Whether kernels can be timed.
    pub timestamps: bool,
}

impl std::fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, {})", self.name, self.backend, self.driver)
    }
}

/// Kind of hardware, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DeviceType {
    /// A graphics card with its own memory.
    Discrete,
    /// A GPU that shares the memory of the processor.
    Integrated,
    /// A GPU behind a virtual machine.
    Virtual,
    /// Unknown.
    Other,
    /// Software Vulkan.
    Cpu,
}

impl DeviceType {
    /// Whether it is known to be a GPU.
    pub fn is_gpu(self) -> bool {
        !matches!(self, Self::Cpu | Self::Other)
    }
}

impl Gpu {
    /// Opens an adapter: the best kind of hardware for `"auto"`, else the first adapter whose name
    /// contains the text, ignoring case.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] when none fits or the device cannot be opened.
    pub fn new(adapter: &str) -> Result<Self, GpuError> {
        open(&choose(adapters(), adapter)?, Most::default())
    }

    /// Opens the best GPU; `None` if all adapters are software or unknown.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] when the GPU cannot be opened.
    pub fn hardware() -> Result<Option<Self>, GpuError> {
        let kind = |adapter: &wgpu::Adapter| device_type(adapter.get_info().device_type);
        let gpus = adapters().into_iter().filter(|adapter| kind(adapter).is_gpu());
        gpus.min_by_key(kind).map(|adapter| open(&adapter, Most::default())).transpose()
    }

    /// Like [`Gpu::new`], with the adapter's binding limit reduced to `most` bytes, so that tests
    /// reach it with little memory.
    ///
    /// # Errors
    /// As [`Gpu::new`].
    pub fn binding_at_most(adapter: &str, most: u64) -> Result<Self, GpuError> {
        open(&choose(adapters(), adapter)?, Most { binding: most, ..Most::default() })
    }

    /// Like [`Gpu::new`], with `most` bytes of memory in buffers, so that tests run out of it.
    ///
    /// # Errors
    /// As [`Gpu::new`].
    pub fn memory_at_most(adapter: &str, most: u64) -> Result<Self, GpuError> {
        open(&choose(adapters(), adapter)?, Most { memory: most, ..Most::default() })
    }

    /// The device and its capabilities.
    pub fn describe(&self) -> &AdapterInfo {
        &self.inner.info
    }

    /// The first fault that the device reported asynchronously; it persists.
    ///
    /// # Errors
    /// [`GpuError::DeviceLost`], [`GpuError::OutOfMemory`] or [`GpuError::Validation`].
    pub fn check(&self) -> Result<(), GpuError> {
        let fault = self.inner.fault.lock().unwrap_or_else(PoisonError::into_inner);
        fault.clone().map_or(Ok(()), Err)
    }

    /// Waits until all submitted work is done.
    ///
    /// # Errors
    /// [`GpuError::Timeout`] or a device error.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.poll(None)
    }

    /// Waits until a submission is done.
    ///
    /// # Errors
    /// As [`Gpu::wait`].
    pub fn wait_for(&self, submission: &Submission) -> Result<(), GpuError> {
        self.poll(Some(submission.0.clone()))
    }

    fn poll(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<(), GpuError> {
        self.check()?;
        let wait = wgpu::PollType::Wait { submission_index, timeout: Some(TIMEOUT) };
        // wgpu panics inside `poll` when the device is lost; here that is an ordinary error.
        let polled = catch_unwind(AssertUnwindSafe(|| self.inner.device.poll(wait)));
        self.check()?;
        match polled {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(_)) => Err(GpuError::Timeout { seconds: TIMEOUT.as_secs() }),
            Err(_) => Err(GpuError::DeviceLost("waiting for the device failed".to_owned())),
        }
    }

    /// Destroys the device, as if the driver had crashed: all later calls return
    /// [`GpuError::DeviceLost`].
    pub fn lose(&self) {
        self.inner.device.destroy();
        note(&self.inner.fault, GpuError::DeviceLost("given up".to_owned()));
    }
}

/// Work submitted to the device.
#[derive(Clone, Debug)]
pub struct Submission(pub(crate) wgpu::SubmissionIndex);

fn adapters() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = APIS.0;
    // Validation of indirect dispatches costs an additional dispatch each; the kernels that
    // write the arguments fold them below 65,535 per dimension (shared/grid.wgsl).
    descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
    let instance = wgpu::Instance::new(descriptor);
    pollster::block_on(instance.enumerate_adapters(APIS.0))
}

fn choose(adapters: Vec<wgpu::Adapter>, wanted: &str) -> Result<wgpu::Adapter, GpuError> {
    let found: Vec<_> = adapters.iter().map(|a| a.get_info().name).collect();
    let name = wanted.to_lowercase();
    let fits =
        |a: &wgpu::Adapter| wanted == "auto" || a.get_info().name.to_lowercase().contains(&name);
    adapters
        .into_iter()
        .filter(fits)
        .min_by_key(|a| device_type(a.get_info().device_type))
        .ok_or_else(|| {
            let reason = if wanted == "auto" {
                format!("no {} driver", APIS.1)
            } else {
                format!("none is named `{wanted}`")
            };
            GpuError::NoAdapter { reason, found }
        })
}

fn device_type(raw: wgpu::DeviceType) -> DeviceType {
    match raw {
        wgpu::DeviceType::DiscreteGpu => DeviceType::Discrete,
        wgpu::DeviceType::IntegratedGpu => DeviceType::Integrated,
        wgpu::DeviceType::VirtualGpu => DeviceType::Virtual,
        wgpu::DeviceType::Cpu => DeviceType::Cpu,
        wgpu::DeviceType::Other => DeviceType::Other,
    }
}

/// Bytes of a graphics card's own memory; `None` for other devices.
fn own_memory(adapter: &wgpu::Adapter) -> Option<u64> {
    let kind = device_type(adapter.get_info().device_type);
    let has_own = matches!(kind, DeviceType::Discrete | DeviceType::Virtual);
    has_own.then(|| largest_heap(adapter)).flatten()
}

/// Bytes of the largest heap that lies on the device; `None` if its API is not Vulkan.
#[cfg(not(target_vendor = "apple"))]
#[allow(unsafe_code)]
fn largest_heap(adapter: &wgpu::Adapter) -> Option<u64> {
    /// The flag of a heap that lies on the device: VK_MEMORY_HEAP_DEVICE_LOCAL_BIT.
    const DEVICE_LOCAL: u32 = 1;
    // SAFETY: the adapter is alive until the end of this function, which destroys nothing, and the
    // physical device belongs to the instance that is asked.
    let properties = unsafe {
        let vulkan = adapter.as_hal::<wgpu::hal::api::Vulkan>()?;
        let instance = vulkan.shared_instance().raw_instance();
        instance.get_physical_device_memory_properties(vulkan.raw_physical_device())
    };
    let heaps = properties.memory_heaps_as_slice().iter();
    let local = heaps.filter(|heap| heap.flags.as_raw() & DEVICE_LOCAL != 0);
    local.map(|heap| heap.size).max()
}

/// Metal tells no heaps. The GPUs of Apple's own processors share the processor's memory.
#[cfg(target_vendor = "apple")]
fn largest_heap(_: &wgpu::Adapter) -> Option<u64> {
    None
}

/// Limits below those of the adapter, bytes.
#[derive(Clone, Copy)]
struct Most {
    binding: u64,
    memory: u64,
}

impl Default for Most {
    fn default() -> Self {
        Self { binding: u64::MAX, memory: u64::MAX }
    }
}

fn open(adapter: &wgpu::Adapter, most: Most) -> Result<Gpu, GpuError> {
    let raw = adapter.get_info();
    let wanted = wgpu::Features::SUBGROUP
        | wgpu::Features::SUBGROUP_BARRIER
        | wgpu::Features::TIMESTAMP_QUERY;
    let features = adapter.features() & wanted;
    let mut limits = adapter.limits();
    limits.max_storage_buffer_binding_size =
        limits.max_storage_buffer_binding_size.min(most.binding);
    let info = AdapterInfo {
        name: raw.name.clone(),
        driver: format!("{} {}", raw.driver, raw.driver_info).trim().to_owned(),
        backend: raw.backend.to_string(),
        device_type: device_type(raw.device_type),
        subgroup: features
            .contains(wgpu::Features::SUBGROUP)
            .then_some((raw.subgroup_min_size, raw.subgroup_max_size)),
        own_memory: own_memory(adapter),
        max_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
    };
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("fled"),
        required_features: features,
        required_limits: limits,
        memory_hints: wgpu::MemoryHints::MemoryUsage,
        ..Default::default()
    };
    let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
        .map_err(|e| GpuError::NoAdapter { reason: e.to_string(), found: vec![raw.name] })?;
    let fault = Arc::new(Mutex::new(None));
    let (uncaptured, lost) = (fault.clone(), fault.clone());
    device.on_uncaptured_error(Arc::new(move |error| note(&uncaptured, translate(error))));
    device.set_device_lost_callback(move |reason, message| {
        if reason != wgpu::DeviceLostReason::Destroyed {
            note(&lost, GpuError::DeviceLost(message));
        }
    });
    let inner = Inner {
        device,
        queue,
        info,
        fault,
        pipelines: Mutex::default(),
        groups: Arc::default(),
        profile: Mutex::default(),
        tally: Arc::default(),
        memory: most.memory,
    };
    Ok(Gpu { inner: Arc::new(inner) })
}

/// Keeps only the first fault, because later ones follow from it.
fn note(slot: &Mutex<Option<GpuError>>, error: GpuError) {
    tracing::error!(%error, "GPU fault");
    slot.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
}

fn translate(error: wgpu::Error) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => {
            GpuError::OutOfMemory { label: "a command".to_owned(), bytes: 0 }
        }
        wgpu::Error::Validation { description, .. } | wgpu::Error::Internal { description, .. } => {
            GpuError::Validation(description)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_adapter_reports_a_heap_and_software_no_memory_of_its_own() {
        let adapters = adapters();
        assert!(!adapters.is_empty(), "tests need a Vulkan driver");
        for adapter in adapters {
            let heap = largest_heap(&adapter).expect("Vulkan requires one");
            assert!((64 << 20..1 << 50).contains(&heap), "{heap} bytes");
            let kind = device_type(adapter.get_info().device_type);
            assert!(kind != DeviceType::Cpu || own_memory(&adapter).is_none(), "{kind:?}");
        }
    }
}
