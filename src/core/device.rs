//! The device that renders and trains: a GPU, or the processor.

mod gpu;
mod processor;
mod scene;

use std::fmt;
use std::fs;
use std::path::Path;

use fled_gpu::{Gpu, GpuError};

use crate::gaussians::Gaussians;
use crate::splat::rows::DeviceGaussians;
pub use gpu::GpuScene;
pub use processor::ProcessorScene;
pub use scene::{Scene, Shaken};

/// The value of `adapter` that requests the processor.
pub const PROCESSOR: &str = "cpu";
/// The value of `adapter` that leaves the device open.
pub const AUTO: &str = "auto";

/// Properties of a device by which the detail of a run is chosen.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceFacts {
    /// Its name, for users.
    pub name: String,
    /// Whether it is known to be a GPU.
    pub is_gpu: bool,
    /// Whether it is the processor itself, not a software driver on it.
    pub is_processor: bool,
    /// Bytes of a GPU's own memory; `None` if it shares the processor's, or if that is unknown.
    pub own_memory: Option<u64>,
}

/// The memory of a machine, bytes; `None` where it is unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryRoom {
    /// Main memory, or what the control group of this process may have of it.
    pub host: Option<u64>,
    /// The GPU's own; `None` also if it has none.
    pub device: Option<u64>,
}

/// A device. Clones are cheap and share it.
#[derive(Clone)]
pub enum Device {
    /// A Vulkan adapter.
    Gpu(Gpu),
    /// All cores of this machine, through `fled-cpu`.
    Processor,
}

impl Device {
    /// Opens the device that `adapter` requests: for `"auto"` a GPU if there is one, else the
    /// processor; for `"cpu"` the processor; else the first Vulkan adapter whose name contains the
    /// text, ignoring case.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] if no adapter fits, a GPU cannot be opened, or the processor lacks
    /// AVX2.
    pub fn new(adapter: &str) -> Result<Self, GpuError> {
        match adapter {
            AUTO => match Gpu::hardware()? {
                Some(gpu) => Ok(Self::Gpu(gpu)),
                None if fled_cpu::is_supported() => Ok(Self::Processor),
                // Software Vulkan also runs on older processors.
                None => Gpu::new(AUTO).map(Self::Gpu),
            },
            PROCESSOR if fled_cpu::is_supported() => Ok(Self::Processor),
            PROCESSOR => Err(GpuError::NoAdapter {
                reason: "the processor lacks AVX2".to_owned(),
                found: Vec::new(),
            }),
            name => Gpu::new(name).map(Self::Gpu),
        }
    }

    /// Whether it is known to be a GPU.
    pub fn is_gpu(&self) -> bool {
        matches!(self, Self::Gpu(gpu) if gpu.describe().device_type.is_gpu())
    }

    /// Its properties by which the detail of a run is chosen.
    pub fn facts(&self) -> DeviceFacts {
        let (name, own_memory) = match self {
            Self::Gpu(gpu) => (gpu.describe().name.clone(), gpu.describe().own_memory),
            Self::Processor => (processor_name(), None),
        };
        let is_processor = matches!(self, Self::Processor);
        DeviceFacts { name, is_gpu: self.is_gpu(), is_processor, own_memory }
    }

    /// The memory of this machine. What others use of it is not taken off: a resumed run must find
    /// the same.
    pub fn memory_room(&self) -> MemoryRoom {
        MemoryRoom { host: host_memory(), device: self.facts().own_memory }
    }

    /// Identifies devices with the same results, bit for bit: an adapter with its driver, or any
    /// processor.
    pub fn identity(&self) -> String {
        match self {
            Self::Gpu(gpu) => gpu.describe().to_string(),
            Self::Processor => "the processor".to_owned(),
        }
    }

    /// Waits until a GPU has done its work and freed what is no longer used.
    ///
    /// # Errors
    /// A device error, also an earlier one: they last.
    pub fn wait(&self) -> Result<(), GpuError> {
        match self {
            Self::Gpu(gpu) => gpu.wait(),
            Self::Processor => Ok(()),
        }
    }

    /// Peak bytes in buffers on a GPU; `None` on the processor.
    pub fn peak_bytes(&self) -> Option<u64> {
        match self {
            Self::Gpu(gpu) => Some(gpu.memory().peak),
            Self::Processor => None,
        }
    }

    /// A scene for renders. Its buffers grow with the images.
    ///
    /// # Errors
    /// Out of memory, or more Gaussians than the adapter can bind.
    pub fn scene(&self, gaussians: &Gaussians) -> Result<Box<dyn Scene>, GpuError> {
        Ok(match self {
            Self::Gpu(gpu) => {
                let uploaded = DeviceGaussians::upload(gpu, gaussians, gaussians.len())?;
                Box::new(GpuScene::new(gpu, uploaded, [1, 1], false)?)
            }
            Self::Processor => Box::new(ProcessorScene::new(gaussians)),
        })
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gpu(gpu) => gpu.describe().fmt(f),
            Self::Processor => {
                let threads = rayon::current_num_threads();
                let vectors = fled_cpu::vectors();
                write!(f, "{} (processor, {vectors}, {threads} threads)", processor_name())
            }
        }
    }
}

/// Main memory, or what the control group of this process may have of it, bytes.
pub fn host_memory() -> Option<u64> {
    let total = meminfo(&fs::read_to_string("/proc/meminfo").unwrap_or_default());
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let group = groups.lines().find_map(|line| line.strip_prefix("0::")).unwrap_or("/");
    let folders = Path::new(group).ancestors().filter_map(|at| at.strip_prefix("/").ok());
    let limit = |below: &Path| {
        let path = Path::new("/sys/fs/cgroup").join(below).join("memory.max");
        fs::read_to_string(path).ok()?.trim().parse().ok()
    };
    folders.filter_map(limit).chain(total).min()
}

/// All memory of a machine by `/proc/meminfo`, bytes.
fn meminfo(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// The processor's model, as its maker calls it.
fn processor_name() -> String {
    let facts = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = facts.lines().find(|line| line.starts_with("model name"));
    let name = model.and_then(|line| line.split_once(':')).map(|(_, name)| name.trim());
    name.unwrap_or("unknown processor").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_opened_by_name_and_an_unknown_adapter_is_refused() {
        let device = Device::new("cpu").expect("tests need AVX2");
        assert!(matches!(device, Device::Processor) && !device.is_gpu());
        let shown = device.to_string();
        assert!(shown.contains("processor, AVX") && shown.contains("threads"), "{shown}");
        assert_eq!(device.identity(), "the processor");
        let facts = device.facts();
        assert!(facts.is_processor && !facts.is_gpu && facts.own_memory.is_none(), "{facts:?}");
        assert!(shown.starts_with(&facts.name), "{}", facts.name);
        let refused = Device::new("no such adapter");
        assert!(matches!(refused, Err(GpuError::NoAdapter { .. })));
    }

    #[test]
    fn the_memory_of_a_machine_is_read() {
        assert_eq!(meminfo("MemTotal:       2048 kB\nMemFree:    1 kB\n"), Some(2 << 20));
        assert_eq!(meminfo("MemFree:    1 kB\n"), None);
        let MemoryRoom { host, device } = Device::Processor.memory_room();
        assert!(host.is_some_and(|host| host > 256 << 20) && device.is_none(), "{host:?}");
    }

    #[test]
    fn auto_takes_a_gpu_or_the_processor_but_no_software_driver() {
        let device = Device::new("auto").expect("opened");
        assert!(device.is_gpu() || matches!(device, Device::Processor), "{device}");
    }
}
