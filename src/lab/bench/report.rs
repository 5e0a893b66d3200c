//! What a bench leaves: one JSON, and the table of it.

use std::collections::BTreeMap;

use fled_gpu::Gpu;
use serde::Serialize;

use super::measure::{Measured, Profiled, median};
use super::options::BenchOptions;
use super::roofline::Peak;
use fled_core::metrics;
use fled_core::noise::NoiseMode;

/// Version of the shape of the JSON.
const FORMAT: u32 = 2;

/// The whole of a bench.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of this shape.
    pub format: u32,
    /// Version of fled.
    pub fled: &'static str,
    /// Where it ran.
    pub machine: Machine,
    /// What was asked for.
    pub options: BenchOptions,
    /// What the device can do at all.
    pub roofline: Roofline,
    /// In the order in which they ran.
    pub cases: Vec<Case>,
    /// A whole job on a capture.
    pub job: Option<JobTimes>,
    /// Most bytes of memory that the process had resident; `None` where the system does not say.
    pub peak_resident_bytes: Option<u64>,
}

/// Where a bench ran.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Name of the device.
    pub adapter: String,
    /// Driver and its version.
    pub driver: String,
    /// `vulkan`.
    pub backend: String,
    /// Kind of hardware.
    pub device_type: String,
    /// Least and most invocations of a subgroup; `None` without subgroups.
    pub subgroup: Option<(u32, u32)>,
    /// Whether the device has a clock for kernels.
    pub timestamps: bool,
    /// Threads of the host's processor.
    pub threads: usize,
}

/// What the device can do at all: medians of what was measured before, between and after the cases.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Roofline {
    /// Arithmetic of a kernel of fused multiply-adds, 10^9 operations a second (a multiply-add is
    /// two).
    pub fma_gflops: f64,
    /// Bytes that a kernel that copies reads and writes, 10^9 a second.
    pub copy_gb_per_second: f64,
    #[serde(skip)]
    all: Vec<Peak>,
}

/// One case.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// For people.
    pub name: String,
    /// `train`, `render`, `ssim` or `sort`.
    pub task: &'static str,
    /// The noise field, when something is trained.
    pub noise: Option<NoiseMode>,
    /// Whether the shake of the views is explained, when something is trained.
    pub shake: Option<bool>,
    /// Gaussians that touch a tile, in the middle one of the measured steps.
    pub visible: Option<usize>,
    /// Pairs of a splat and a tile, in the same step.
    pub intersections: Option<usize>,
    /// Steps, images or sorts a second, without timestamps.
    pub steps_per_second: f64,
    /// The reciprocal, ms.
    pub milliseconds: f64,
    /// How many were made for that.
    pub steps: u32,
    /// How many were made with timestamps.
    pub profiled_steps: u32,
    /// Median of such a step on the host's clock, ms: longer, for every kernel waits for the one
    /// before.
    pub profiled_milliseconds: Option<f64>,
    /// Median of the sum of a step's kernels, ms.
    pub kernel_milliseconds: Option<f64>,
    /// Most bytes in buffers on the device.
    pub gpu_peak_bytes: u64,
    /// The longest first; empty on a device without timestamps.
    pub kernels: Vec<KernelRow>,
}

/// One kernel of a case: medians over the steps.
#[derive(Clone, Debug, Serialize)]
pub struct KernelRow {
    /// `family/verb`.
    pub kernel: &'static str,
    /// ms a step, all dispatches together.
    pub milliseconds: f64,
    /// Share of the sum of the rows, 0..=1.
    pub share: f64,
    /// Dispatches a step.
    pub dispatches: u64,
    /// Its time over that in which the roofline kernel that copies reads and writes a megabyte.
    pub copies: f64,
    /// Its time over that in which the roofline kernel of arithmetic makes a million operations.
    pub fmas: f64,
}

/// A whole job, from the photographs to the result.
#[derive(Clone, Debug, Serialize)]
pub struct JobTimes {
    /// Preset.
    pub preset: String,
    /// Registered views.
    pub views: u32,
    /// Rounds.
    pub rounds: usize,
    /// Training steps of all rounds.
    pub steps: u64,
    /// Gaussians of the last round.
    pub gaussians: u64,
    /// Training steps a second in the last round.
    pub steps_per_second: f64,
    /// Wall seconds by stage, as in `metrics.json`.
    pub stages: BTreeMap<String, f64>,
    /// Wall seconds of the job.
    pub seconds: f64,
    /// Most bytes in buffers on the device.
    pub gpu_peak_bytes: u64,
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

    /// Relates every kernel to the roofline, and notes the process's memory.
    pub(super) fn relate(&mut self) {
        let roofline = &self.roofline;
        for row in self.cases.iter_mut().flat_map(|case| &mut case.kernels) {
            // 10^9 a second are a million in a millisecond.
            row.copies = row.milliseconds * roofline.copy_gb_per_second;
            row.fmas = row.milliseconds * roofline.fma_gflops;
        }
        self.peak_resident_bytes = peak_resident();
    }
}

impl Machine {
    pub(super) fn of(gpu: &Gpu) -> Self {
        let info = gpu.describe();
        Self {
            adapter: info.name.clone(),
            driver: info.driver.clone(),
            backend: info.backend.clone(),
            device_type: format!("{:?}", info.device_type).to_lowercase(),
            subgroup: info.subgroup,
            timestamps: info.timestamps,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
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
        gpu_peak_bytes: u64,
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
    /// From the report of a finished run that took `seconds`.
    pub fn new(preset: &str, report: &metrics::Report, seconds: f64, gpu_peak_bytes: u64) -> Self {
        let last = report.rounds.last();
        Self {
            preset: preset.to_owned(),
            views: report.registered,
            rounds: report.rounds.len(),
            steps: report.rounds.iter().map(|round| round.steps).sum(),
            gaussians: last.map_or(0, |round| round.gaussians),
            steps_per_second: last.map_or(0.0, |round| round.steps_per_second),
            stages: report.stages.clone(),
            seconds,
            gpu_peak_bytes,
        }
    }
}

/// Most bytes that this process had resident, as Linux counts them.
fn peak_resident() -> Option<u64> {
    parse_peak(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn parse_peak(status: &str) -> Option<u64> {
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim()
        .strip_suffix("kB")?
        .trim()
        .parse::<u64>()
        .ok()
        .map(|kib| 1024 * kib)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_of_the_process_is_read_in_bytes() {
        assert_eq!(
            parse_peak("VmPeak:\t 90 kB\nVmHWM:\t   12 kB\n"),
            Some(12_288)
        );
        assert_eq!(parse_peak("VmPeak:\t 90 kB\n"), None);
    }
}
