//! The device's limits: the peak arithmetic and bandwidth of a plain kernel.

use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use fled_core::device::Device;
use fled_cpu::roofline;
use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recording, read, read_write, uniform};

use super::measure::median;

const FMA: Kernel = Kernel::new("bench/fma", &[uniform("size"), read_write("sums")]);
const COPY: Kernel =
    Kernel::new("bench/copy", &[uniform("size"), read("source"), read_write("copied")]);

/// `FMAS` of shaders/bench/fma.wgsl.
const FMAS: u64 = 24;
/// Invocations of the arithmetic kernel, enough to fill the largest devices.
const INVOCATIONS: usize = 1 << 18;
/// Minimum seconds of the arithmetic kernel, far above the cost of a dispatch; it runs more rounds
/// until it takes that long.
const LONG_ENOUGH: f64 = 4e-3;
const MOST_ROUNDS: u32 = 1 << 16;
/// Number of copied bytes, more than the caches of large devices hold.
const COPIED: u64 = 128 << 20;
/// Number of repetitions; the median counts.
const REPEATS: usize = 7;

/// Operations and bytes per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Peak {
    /// Operations per second; a fused multiply-add is two.
    pub(super) operations: f64,
    /// Bytes read and written per second.
    pub(super) bytes: f64,
}

/// `RooflineUniform` of shaders/bench.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct RooflineUniform {
    count: u32,
    rounds: u32,
    factor: f32,
    offset: f32,
}

impl RooflineUniform {
    fn new(count: usize, rounds: u32) -> Self {
        // Chains converge to 500: they neither overflow nor become slow subnormal numbers.
        Self { count: count as u32, rounds, factor: 0.999, offset: 0.5 }
    }
}

pub(super) fn measure(device: &Device) -> Result<Peak, GpuError> {
    match device {
        Device::Gpu(gpu) => of_gpu(gpu),
        Device::Processor => Ok(of_processor()),
    }
}

fn of_processor() -> Peak {
    const TASKS: usize = 64;
    const ROUNDS: u32 = 20_000;
    let median_of = |work: &mut dyn FnMut()| {
        let seconds = |_| {
            let begin = Instant::now();
            work();
            begin.elapsed().as_secs_f64()
        };
        median((0..REPEATS).map(seconds).collect()).max(1e-9)
    };
    let arithmetic = median_of(&mut || {
        std::hint::black_box(roofline::multiply_adds(TASKS, ROUNDS));
    });
    let operations = TASKS as u64 * u64::from(ROUNDS) * roofline::OPERATIONS;
    let source = vec![1.0; COPIED as usize / size_of::<f32>()];
    let mut copied = vec![0.0; source.len()];
    let copying = median_of(&mut || roofline::copy(&source, &mut copied));
    Peak { operations: operations as f64 / arithmetic, bytes: (2 * COPIED) as f64 / copying }
}

fn of_gpu(gpu: &Gpu) -> Result<Peak, GpuError> {
    Ok(Peak { operations: arithmetic(gpu)?, bytes: bandwidth(gpu)? })
}

fn arithmetic(gpu: &Gpu) -> Result<f64, GpuError> {
    let sums: Buffer<[f32; 4]> = gpu.create("roofline", INVOCATIONS)?;
    let mut rounds = 16;
    let size = gpu.upload("roofline size", &[RooflineUniform::new(INVOCATIONS, rounds)])?;
    let mut recorder = gpu.recorder();
    recorder.dispatch_items(&FMA, &[&size, &sums], INVOCATIONS)?;
    let recording = recorder.finish();
    seconds(gpu, &recording)?;
    while rounds < MOST_ROUNDS && seconds(gpu, &recording)? < LONG_ENOUGH {
        rounds *= 2;
        size.write(&[RooflineUniform::new(INVOCATIONS, rounds)])?;
    }
    let operations = 2 * 4 * FMAS * u64::from(rounds) * INVOCATIONS as u64;
    Ok(operations as f64 / typical(gpu, &recording)?)
}

fn bandwidth(gpu: &Gpu) -> Result<f64, GpuError> {
    let count = (COPIED.min(gpu.describe().max_binding) / 16) as usize;
    let source: Buffer<[f32; 4]> = gpu.create("roofline source", count)?;
    let copied: Buffer<[f32; 4]> = gpu.create("roofline copy", count)?;
    let size = gpu.upload("roofline size", &[RooflineUniform::new(count, 0)])?;
    let mut recorder = gpu.recorder();
    recorder.dispatch_items(&COPY, &[&size, &source, &copied], count)?;
    let recording = recorder.finish();
    seconds(gpu, &recording)?;
    Ok((2 * 16 * count) as f64 / typical(gpu, &recording)?)
}

fn typical(gpu: &Gpu, recording: &Recording) -> Result<f64, GpuError> {
    let times = (0..REPEATS).map(|_| seconds(gpu, recording)).collect::<Result<_, _>>()?;
    Ok(median(times).max(1e-9))
}

/// Seconds of one submission by the device's clock, or by the host's if the device has none.
fn seconds(gpu: &Gpu, recording: &Recording) -> Result<f64, GpuError> {
    gpu.profile(true);
    let begin = Instant::now();
    let submitted = recording.submit().and_then(|_| gpu.wait());
    let wall = begin.elapsed().as_secs_f64();
    let timed = gpu.profiled();
    gpu.profile(false);
    submitted?;
    Ok(timed.first().map_or(wall, |(_, time)| time.total.as_secs_f64()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A separate device: profiling covers the whole device.
    fn gpu() -> Gpu {
        Gpu::new("auto").expect("GPU tests need a Vulkan adapter; lavapipe will do")
    }

    #[test]
    fn the_uniform_has_the_shaders_layout() {
        let (_, fma) = FMA.reflect().expect("valid");
        let (_, copy) = COPY.reflect().expect("valid");
        assert_eq!(fma.constant("FMAS"), Some(FMAS as f64));
        for found in [fma, copy] {
            let size = found.structure("RooflineUniform").expect("declared").size as usize;
            assert_eq!(size, size_of::<RooflineUniform>());
        }
    }

    #[test]
    fn the_device_computes_and_copies_something() {
        for device in [Device::Gpu(gpu()), Device::Processor] {
            let found = measure(&device).expect("measured");
            assert!(found.operations > 1e6 && found.bytes > 1e6, "{found:?}");
        }
    }

    #[test]
    fn a_copy_copies() {
        let gpu = gpu();
        let source = gpu.upload("source", &[[1.0_f32, 2.0, 3.0, 4.0]; 5]).expect("uploaded");
        let copied: Buffer<[f32; 4]> = gpu.create("copied", 5).expect("created");
        let size = gpu.upload("size", &[RooflineUniform::new(4, 0)]).expect("uploaded");
        let mut recorder = gpu.recorder();
        recorder.dispatch_items(&COPY, &[&size, &source, &copied], 4).expect("recorded");
        recorder.submit().expect("submitted");
        let values = copied.read().expect("read");
        assert_eq!((values[3], values[4]), ([1.0, 2.0, 3.0, 4.0], [0.0; 4]));
    }
}
