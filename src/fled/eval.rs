//! `fled eval`: judges a finished run by sharp photographs.

use std::path::{Path, PathBuf};

use fled_core::device::Device;
use fled_core::inference::runtime;
use fled_core::metrics::Report;
use fled_core::pipeline::error::ErrorKind;
use fled_core::run_folder::RunFolder;
use fled_lab::evaluation::{self, EvaluationError, Lpips, Request, Subject, Truth};

use crate::failure::{Failure, io};
use crate::{suite, tools};

/// Arguments of `fled eval`.
#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    /// Output folder of `fled run`.
    #[arg(required = true)]
    run: Option<PathBuf>,
    /// Folder of sharp photographs with poses: those of the capture, with the same names, and
    /// others, on which the run is tested.
    #[arg(long, value_name = "DIR", required = true)]
    truth: Option<PathBuf>,
    /// Folder for the verdict [default: evaluation/ in the run's folder].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Folder of masks named like the test views, as those of a capture; black areas are not
    /// scored.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// Tests only photographs that lie between two training views in name order.
    #[arg(long)]
    inside: bool,
    /// Run whose scene decides which pixels two training views see, so that several runs of a
    /// capture are compared on the same pixels [default: the judged run].
    #[arg(long, value_name = "RUN")]
    seen_from: Option<PathBuf>,
    /// LPIPS as an ONNX network with the inputs `ref` and `dist` and the output `score`.
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// Path of the ONNX Runtime library, for LPIPS.
    #[arg(long, value_name = "FILE", env = "ORT_DYLIB_PATH")]
    onnxruntime: Option<PathBuf>,
    /// The device: auto, cpu, or part of a Vulkan adapter's name.
    #[arg(long, default_value = "auto")]
    adapter: String,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Runs captures in several configurations with several seeds, judges every run, and reports
    /// what differs.
    Suite(suite::Args),
}

impl From<EvaluationError> for Failure {
    fn from(error: EvaluationError) -> Self {
        Self { hint: error.hint(), ..Self::new(error.kind(), error) }
    }
}

/// Judges the run, writes the verdict, and prints its table; or runs a suite.
///
/// # Errors
/// [`Failure`] if the run, the truth, the network or the adapter is missing.
pub fn main(args: &Args) -> Result<(), Failure> {
    match (&args.command, &args.run, &args.truth) {
        (Some(Command::Suite(args)), ..) => suite::main(args),
        (None, Some(run), Some(truth)) => judge(args, run, truth),
        _ => Err(Failure::usage("give a run and --truth, or `suite`")),
    }
}

fn judge(args: &Args, run: &Path, truth: &Path) -> Result<(), Failure> {
    let run = RunFolder::new(run);
    let round = delivered_round(&run)?;
    let subject = Subject::open(&run)?;
    let seen_from = args.seen_from.as_ref();
    let seen_from = seen_from.map(|run| Subject::open(&RunFolder::new(run)));
    let seen_from = seen_from.transpose()?;
    let out = args.out.clone().unwrap_or_else(|| run.evaluation());
    let scratch = tempfile::tempdir().map_err(|e| Failure::new(ErrorKind::Io, e))?;
    let truth = Truth::open(truth, scratch.path(), subject.longest_side())?;
    let lpips = args.lpips.as_deref().map(|path| open_lpips(args, path));
    let mut lpips = lpips.transpose()?;
    let device = Device::new(&args.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    let judged = evaluation::evaluate(Request {
        subject: &subject,
        truth: &truth,
        seen_from: seen_from.as_ref().unwrap_or(&subject),
        masks: args.masks.as_deref(),
        inside: args.inside,
        device: &device,
        lpips: lpips.as_mut(),
        cancel: &tools::cancel_on_signals()?,
    })?;
    evaluation::write(&judged, &run, round, &out)?;
    print(&evaluation::table(&judged.evaluation))
}

fn open_lpips(args: &Args, path: &Path) -> Result<Lpips, Failure> {
    let search = tools::Args::library_folders();
    let runtime = runtime::load(args.onnxruntime.as_deref(), &search)
        .map_err(|e| Failure::new(ErrorKind::Environment, e))?;
    Ok(Lpips::open(&runtime, path)?)
}

/// The delivered round of a run.
fn delivered_round(run: &RunFolder) -> Result<u32, Failure> {
    let path = run.metrics();
    let bytes = std::fs::read(&path).map_err(io(&path))?;
    let report: Report = serde_json::from_slice(&bytes)
        .map_err(|e| Failure::new(ErrorKind::BadInput, format!("{}: {e}", path.display())))?;
    Ok(report.best_round)
}

fn print(table: &str) -> Result<(), Failure> {
    use std::io::Write;
    std::io::stdout().lock().write_all(table.as_bytes()).map_err(|e| Failure::new(ErrorKind::Io, e))
}
