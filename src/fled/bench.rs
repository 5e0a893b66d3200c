//! `fled bench`: measures training and rendering on this machine.

use std::path::{Path, PathBuf};
use std::time::Instant;

use fled_core::cancel::CancelToken;
use fled_core::capture::{Capture, PREPARED_SIDE, Watch};
use fled_core::device::Device;
use fled_core::event::Event;
use fled_core::pipeline::config::Preset;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::pipeline::workspace::Workspace;
use fled_core::pipeline::{self};
use fled_core::reconstruct::ReconstructError;
use fled_lab::bench::report::JobTimes;
use fled_lab::bench::{self, BenchError, BenchOptions, Budget, MOST_STEPS, Workload};

use crate::failure::{Failure, io};
use crate::{synth, tools};

/// Arguments of `fled bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Image sizes in px, separated by commas.
    #[arg(long, value_delimiter = ',', value_name = "WxH", value_parser = synth::size)]
    sizes: Vec<(usize, usize)>,
    /// Numbers of Gaussians, separated by commas; `10k` means 10,000.
    #[arg(long, value_delimiter = ',', value_name = "N", value_parser = count)]
    gaussians: Vec<usize>,
    /// Maximum steps per case, once without timestamps and once with them.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_STEPS)))]
    steps: Option<u32>,
    /// Maximum seconds per case, counted twice; at least three steps always run.
    #[arg(long)]
    seconds: Option<f64>,
    /// Uses one small size and a few steps, to check that everything runs.
    #[arg(long)]
    quick: bool,
    /// Also runs this whole capture and measures its scene.
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Preset for the capture's run.
    #[arg(long, default_value = "preview", requires = "capture")]
    preset: Preset,
    /// Overrides one option of the preset for the capture's run; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "capture")]
    assignments: Vec<String>,
    /// File for the results as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// The device: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
    #[command(flatten)]
    tools: tools::Args,
}

impl Args {
    fn options(&self) -> Result<BenchOptions, Failure> {
        let mut options = if self.quick { BenchOptions::quick() } else { BenchOptions::default() };
        if !self.sizes.is_empty() {
            options.sizes.clone_from(&self.sizes);
        }
        if !self.gaussians.is_empty() {
            options.gaussians.clone_from(&self.gaussians);
        }
        let seconds = self.seconds.unwrap_or(options.budget.seconds);
        if !(seconds.is_finite() && seconds > 0.0) {
            return Err(Failure::usage(format!("--seconds must be above 0, not {seconds}")));
        }
        options.budget = Budget { seconds, steps: self.steps.unwrap_or(options.budget.steps) };
        Ok(options)
    }
}

/// Parses a number of Gaussians.
fn count(text: &str) -> Result<usize, String> {
    let (digits, unit) = match text.strip_suffix(['k', 'K']) {
        Some(digits) => (digits, 1000),
        None => (text, 1),
    };
    let parsed = digits.parse::<usize>().ok().and_then(|n| n.checked_mul(unit));
    parsed
        .filter(|n| (1..=5_000_000).contains(n))
        .ok_or_else(|| format!("`{text}` is not a number of Gaussians up to 5000k"))
}

/// Measures, prints the table and writes the JSON.
///
/// # Errors
/// [`Failure`], of kind `environment` without an adapter.
pub fn main(args: &Args) -> Result<(), Failure> {
    let options = args.options()?;
    let cancel = tools::cancel_on_signals()?;
    let device = Device::new(&args.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    // The job runs first, so that an error in a capture shows at once and not after minutes.
    let job = args.capture.as_deref().map(|capture| run_job(args, capture, &cancel)).transpose()?;
    eprintln!("measuring on {}", device);
    let mut report = bench::run(&device, &options, &mut progress, &cancel)?;
    if let Some((times, scene)) = job {
        bench::run_scene(&device, &scene, &mut report, &mut progress, &cancel)?;
        report.job = Some(times);
    }
    print(&report.table())?;
    if let Some(path) = &args.json {
        let json = serde_json::to_string_pretty(&report)
            .map_err(|e| Failure::new(ErrorKind::Internal, e))?;
        std::fs::write(path, json + "\n").map_err(io(path))?;
    }
    Ok(())
}

fn progress(done: usize, total: usize, name: &str) {
    eprintln!("[{}/{total}] {name}", done + 1);
}

fn print(table: &str) -> Result<(), Failure> {
    use std::io::Write;
    std::io::stdout().lock().write_all(table.as_bytes()).map_err(|e| Failure::new(ErrorKind::Io, e))
}

/// Runs `fled run` in a temporary folder, and returns its times and its scene. Poses are not
/// cached: finding them is a stage like any other.
fn run_job(
    args: &Args,
    capture: &Path,
    cancel: &CancelToken,
) -> Result<(JobTimes, Workload), Failure> {
    let mut options = args.preset.options();
    for assignment in &args.assignments {
        options = options.with_assignment(assignment)?;
    }
    options.adapter.clone_from(&args.adapter);
    let folder = tempfile::tempdir().map_err(|e| Failure::new(ErrorKind::Io, e))?;
    let workspace = Workspace::open(folder.path())?;
    eprintln!("running {} with preset {}", capture.display(), args.preset.name());
    let begin = Instant::now();
    let side = PREPARED_SIDE.max(options.longest_side() as usize);
    let prepared = workspace.folder().work().prepared();
    let capture = Capture::prepare(capture, &prepared, side, &Watch::silent());
    let capture = capture.map_err(PipelineError::from)?;
    let places = tools::Args { cache: Some("none".into()), ..args.tools.clone() };
    let mut kit = tools::Kit::new(&places, &options, tools::device(&options)?, &capture)?;
    let outcome =
        pipeline::run(&capture, &options, &mut kit.tools(), &workspace, &mut print_stage, cancel)?;
    let seconds = begin.elapsed().as_secs_f64();
    let times =
        JobTimes::new(args.preset.name(), &outcome.report, seconds, kit.device().peak_bytes());
    Ok((times, Workload::of_run(folder.path())?))
}

/// Prints each stage as it begins.
fn print_stage(event: &Event) {
    if let Event::StageStarted { stage, round } = event {
        eprintln!("  {} (round {round})", stage.name());
    }
}

impl From<BenchError> for Failure {
    fn from(error: BenchError) -> Self {
        match error {
            BenchError::Gpu(error) => PipelineError::from(ReconstructError::Gpu(error)).into(),
            BenchError::Reconstruct(error) => PipelineError::from(error).into(),
            BenchError::Render(error) => PipelineError::from(error).into(),
            BenchError::Scene(error) => PipelineError::from(error).into(),
            BenchError::Cancelled(error) => PipelineError::from(error).into(),
            BenchError::Empty(_) | BenchError::Steps(_) => Self::usage(error),
            BenchError::Image(_) | BenchError::Run(_) => Self::new(ErrorKind::Io, error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn k_means_thousand_and_invalid_counts_are_refused() {
        assert_eq!((count("10k"), count("2500")), (Ok(10_000), Ok(2_500)));
        for wrong in ["", "k", "0", "ten", "-3", "9999999k", "99999999999999999999"] {
            assert!(count(wrong).is_err(), "{wrong}");
        }
    }
}
