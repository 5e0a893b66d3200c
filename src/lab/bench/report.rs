//! The result of a benchmark as JSON.

use std::collections::BTreeMap;

use serde::Serialize;

use super::measure::{Measured, Profiled, median};
use super::options::BenchOptions;
use super::roofline::Peak;
use fled_core::device::Device;
use fled_core::metrics;
use fled_core::metrics::report::BetweenSteps;
use fled_core::noise::NoiseMode;

/// Version of the JSON schema.
const FORMAT: u32 = 3;

/// The result of a benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of the schema.
    pub format: u32,
    /// Version of fled.
    pub fled: &'static str,
    /// The machine.
    pub machine: Machine,
    /// The requested options.
    pub options: BenchOptions,
    /// The device's limits.
    pub roofline: Roofline,
    /// Cases in the order of execution.
    pub cases: Vec<Case>,
    /// A whole job on a capture.
    pub job: Option<JobTimes>,
    /// Peak resident memory of the process; `None` if the system does not report it.
    pub peak_resident_bytes: Option<u64>,
}

/// The machine of a benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Name of the device.
    pub adapter: String,
    /// Driver and its version.
    pub driver: String,
    /// The graphics API, such as `vulkan`, or `processor`.
    pub backend: String,
    /// Kind of hardware.
    pub device_type: String,
    /// Minimum and maximum number of invocations in a subgroup; `None` without subgroups.
    pub subgroup: Option<(u32, u32)>,
    /// Whether the device has timestamps for kernels.
    pub timestamps: bool,
    /// Number of hardware threads of the host.
    pub threads: usize,
}

/// The device's limits: medians of measurements before, between and after the cases.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Roofline {
    /// Arithmetic of a kernel of fused multiply-adds, 10^9 operations per second (a multiply-add is
    /// two).
    pub fma_gflops: f64,
    /// Bytes read and written by a copy kernel, 10^9 per second.
    pub copy_gb_per_second: f64,
    #[serde(skip)]
    all: Vec<Peak>,
}

/// One case.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// Name shown to users.
    pub name: String,
    /// `train`, `render`, `ssim` or `sort`.
    pub task: &'static str,
    /// The noise field, for training.
    pub noise: Option<NoiseMode>,
    /// Whether kernels explain the shake of the views, for training.
    pub shake: Option<bool>,
    /// Gaussians that touch a tile, in the median of the measured steps.
    pub visible: Option<usize>,
    /// Pairs of a splat and a tile, in the same step.
    pub intersections: Option<usize>,
    /// Steps, images or sorts per second, without timestamps.
    pub steps_per_second: f64,
    /// The reciprocal of `steps_per_second`, ms.
    pub milliseconds: f64,
    /// Number of these steps.
    pub steps: u32,
    /// Number of steps with timestamps.
    pub profiled_steps: u32,
    /// Median of these steps on the host's clock, ms: longer, because every kernel waits for the
    /// previous one.
    pub profiled_milliseconds: Option<f64>,
    /// Median of the sum of the kernels in a step, ms.
    pub kernel_milliseconds: Option<f64>,
    /// Peak bytes in buffers on the GPU; `None` on the processor.
    pub gpu_peak_bytes: Option<u64>,
    /// Kernels, the slowest first; empty on a device without timestamps.
    pub kernels: Vec<KernelRow>,
}

/// One kernel of a case: medians over the steps.
#[derive(Clone, Debug, Serialize)]
pub struct KernelRow {
    /// `family/verb`.
    pub kernel: &'static str,
    /// Time per step, ms, of all dispatches together.
    pub milliseconds: f64,
    /// Share of the sum of the rows, 0..=1.
    pub share: f64,
    /// Dispatches per step.
    pub dispatches: u64,
    /// Time as a multiple of the time in which the roofline's copy kernel reads and writes a
    /// megabyte.
    pub copies: f64,
    /// Time as a multiple of the time in which the roofline's arithmetic kernel does a million
    /// operations.
    pub fmas: f64,
}

/// A whole job, from the photographs to the result.
#[derive(Clone, Debug, Serialize)]
pub struct JobTimes {
    /// Name of the preset.
    pub preset: String,
    /// Number of registered views.
    pub views: u32,
    /// Number of rounds.
    pub rounds: usize,
    /// Training steps of all rounds.
    pub steps: u64,
    /// Number of Gaussians in the last round.
    pub gaussians: u64,
    /// Training steps per second in the last round.
    pub steps_per_second: f64,
    /// Wall seconds of training between the steps, by round.
    pub between: Vec<BetweenSteps>,
    /// Wall seconds by stage, as in `metrics.json`.
    pub stages: BTreeMap<String, f64>,
    /// Wall seconds of the job.
    pub seconds: f64,
    /// Peak bytes in buffers on the GPU; `None` on the processor.
    pub gpu_peak_bytes: Option<u64>,
}

impl Report {
    pub(super) fn new(machine: Machine, options: &BenchOptions) -> Self {
        Self {
            format: FORMAT,
            fled: env!("CARGO_PKG_VERSION"),
            machine,
            options: options.clone(),
            roofline: Roofline::default(),
            cases: Vec::new(),
            job: None,
            peak_resident_bytes: None,
        }
    }

    /// Relates every kernel to the roofline, and records the process's memory.
    pub(super) fn relate(&mut self) {
        let roofline = &self.roofline;
        for row in self.cases.iter_mut().flat_map(|case| &mut case.kernels) {
            // 10^9 per second are a million per millisecond.
            row.copies = row.milliseconds * roofline.copy_gb_per_second;
            row.fmas = row.milliseconds * roofline.fma_gflops;
        }
        self.peak_resident_bytes = peak_resident();
    }
}

impl Machine {
    pub(super) fn of(device: &Device) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let Device::Gpu(gpu) = device else {
            return Self {
                adapter: device.to_string(),
                driver: concat!("fled-cpu ", env!("CARGO_PKG_VERSION")).to_owned(),
                backend: "processor".to_owned(),
                device_type: "cpu".to_owned(),
                subgroup: None,
                timestamps: false,
                threads,
            };
        };
        let info = gpu.describe();
        Self {
            adapter: info.name.clone(),
            driver: info.driver.clone(),
            backend: info.backend.clone(),
            device_type: format!("{:?}", info.device_type).to_lowercase(),
            subgroup: info.subgroup,
            timestamps: info.timestamps,
            threads,
        }
    }
}

impl Roofline {
    pub(super) fn add(&mut self, found: Peak) {
        self.all.push(found);
        self.fma_gflops = median(self.all.iter().map(|one| one.operations / 1e9).collect());
        self.copy_gb_per_second = median(self.all.iter().map(|one| one.bytes / 1e9).collect());
    }
}

impl Case {
    pub(super) fn new(
        name: String,
        task: &'static str,
        measured: &Measured,
        gpu_peak_bytes: Option<u64>,
    ) -> Self {
        let counts = measured.counts;
        let profiled = measured.profiled.as_ref();
        let milliseconds = 1e3 * measured.seconds / f64::from(measured.steps.max(1));
        Self {
            name,
            task,
            noise: None,
            shake: None,
            visible: counts.map(|counts| counts.visible),
            intersections: counts.map(|counts| counts.intersections),
            steps_per_second: 1e3 / milliseconds,
            milliseconds,
            steps: measured.steps,
            profiled_steps: profiled.map_or(0, |profiled| profiled.steps),
            profiled_milliseconds: profiled.map(|profiled| 1e3 * profiled.wall),
            kernel_milliseconds: profiled.map(|profiled| 1e3 * profiled.kernels),
            gpu_peak_bytes,
            kernels: profiled.map_or_else(Vec::new, kernels),
        }
    }
}

fn kernels(profiled: &Profiled) -> Vec<KernelRow> {
    let sum: f64 = profiled.rows.iter().map(|row| row.1).sum();
    let row = |&(kernel, seconds, dispatches): &(&'static str, f64, u64)| KernelRow {
        kernel,
        milliseconds: 1e3 * seconds,
        share: if sum > 0.0 { seconds / sum } else { 0.0 },
        dispatches,
        copies: 0.0,
        fmas: 0.0,
    };
    profiled.rows.iter().map(row).collect()
}

impl JobTimes {
    /// Reads the report of a finished run that took `seconds`.
    pub fn new(
        preset: &str,
        report: &metrics::Report,
        seconds: f64,
        gpu_peak_bytes: Option<u64>,
    ) -> Self {
        let last = report.rounds.last();
        Self {
            preset: preset.to_owned(),
            views: report.registered,
            rounds: report.rounds.len(),
            steps: report.rounds.iter().map(|round| round.steps).sum(),
            gaussians: last.map_or(0, |round| round.gaussians),
            steps_per_second: last.map_or(0.0, |round| round.steps_per_second),
            between: report.rounds.iter().filter_map(|round| round.between).collect(),
            stages: report.stages.clone(),
            seconds,
            gpu_peak_bytes,
        }
    }
}

/// Peak resident bytes of this process, according to Linux.
fn peak_resident() -> Option<u64> {
    parse_peak(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn parse_peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| 1024 * kib)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_of_the_process_is_parsed_in_bytes() {
        assert_eq!(parse_peak("VmPeak:\t 90 kB\nVmHWM:\t   12 kB\n"), Some(12_288));
        assert_eq!(parse_peak("VmPeak:\t 90 kB\n"), None);
    }
}
