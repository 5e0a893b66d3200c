//! `fled eval suite`: runs and judges captures x configurations x seeds, and compares them.

mod child;

use std::collections::BTreeMap;
use std::io::ErrorKind::NotFound;
use std::io::Write;
use std::path::{Path, PathBuf};

use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_lab::evaluation::suite::error::SuiteError;
use fled_lab::evaluation::suite::file::{Selection, Suite};
use fled_lab::evaluation::suite::records::Records;
use fled_lab::evaluation::suite::runner::{Hands, run};
use fled_lab::evaluation::suite::setup::Setup;
use fled_lab::evaluation::suite::summary::Summary;

use crate::failure::{Failure, io};
use crate::tools;
use child::Program;

/// The doctor's checks of components that affect results. The disk is not one of them.
const COMPUTING: [&str; 5] = ["adapter", "colmap", "onnxruntime", "models", "matcher"];

/// Arguments of `fled eval suite`.
#[derive(clap::Args)]
pub struct Args {
    /// JSON file of the suite.
    file: PathBuf,
    /// Folder for records, runs and evaluations; what it already holds is not repeated.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Runs only this configuration, besides the first and those whose times it needs; may be
    /// repeated.
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Runs only these captures.
    #[arg(long, value_name = "NAME", num_args = 1..)]
    captures: Vec<String>,
    /// JSON list of captures to use instead of the suite's.
    #[arg(long, value_name = "FILE")]
    capture_list: Option<PathBuf>,
    /// Number of seeds to use instead of the suite's.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    seeds: Option<u64>,
    /// Overrides one option of every run; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Runs nothing and prints what is recorded.
    #[arg(long)]
    finished: bool,
    /// File for all results as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    tools: tools::Args,
}

/// Runs the suite and prints its tables.
///
/// # Errors
/// [`Failure`]: wrong use for an invalid suite. A failed run is not an error but a row.
pub fn main(args: &Args) -> Result<(), Failure> {
    let suite = suite(args)?;
    let program = Program::own(&args.tools)?;
    let mut setup = Setup::open(program.path(), machine(&program)?, args.tools.models.folders())?;
    setup.poses.clone_from(&args.tools.cache);
    let records = Records::new(&args.out);
    let runs = if args.finished {
        run(&suite, &setup, &records, None)?
    } else {
        let cancel = tools::cancel_on_signals()?;
        let hands = Hands {
            start: &mut |words| program.run(words, &cancel),
            tell: &mut |text| eprintln!("{text}"),
        };
        run(&suite, &setup, &records, Some(hands))?
    };
    let summary = Summary::new(&suite, runs);
    std::io::stdout()
        .lock()
        .write_all(summary.markdown().as_bytes())
        .map_err(|e| Failure::new(ErrorKind::Io, e))?;
    match &args.json {
        Some(path) => write_json(path, &summary),
        None => Ok(()),
    }
}

fn suite(args: &Args) -> Result<Suite, SuiteError> {
    let mut suite = Suite::read(&args.file)?;
    if let Some(path) = &args.capture_list {
        suite = suite.with_captures_of(path)?;
    }
    suite.with_assignments(&args.assignments)?.selected(&Selection {
        only: args.only.clone(),
        captures: args.captures.clone(),
        seeds: args.seeds,
    })
}

fn write_json(path: &Path, summary: &Summary) -> Result<(), Failure> {
    let text =
        serde_json::to_string_pretty(summary).map_err(|e| Failure::new(ErrorKind::Internal, e))?;
    std::fs::write(path, text + "\n").map_err(io(path))
}

/// The components of this machine that affect results, as reported by the doctor.
fn machine(program: &Program) -> Result<BTreeMap<String, String>, SuiteError> {
    let report = program.asked(&["doctor", "--json"])?;
    let checks = report["checks"].as_array().into_iter().flatten();
    let named = checks.filter_map(|check| {
        let (name, detail) = (check["name"].as_str()?, check["detail"].as_str()?);
        COMPUTING.contains(&name).then(|| (name.to_owned(), detail.to_owned()))
    });
    let found: BTreeMap<String, String> = named.collect();
    if found.len() != COMPUTING.len() {
        return Err(SuiteError::Child(format!(
            "`fled doctor` does not report what this machine computes with: {report}"
        )));
    }
    Ok(found)
}

impl From<SuiteError> for Failure {
    fn from(error: SuiteError) -> Self {
        match error {
            SuiteError::Wrong(_) | SuiteError::Options { .. } => Self::usage(error),
            SuiteError::Io { error: ref why, .. } if why.kind() == NotFound => Self::usage(error),
            SuiteError::Cancelled(error) => PipelineError::from(error).into(),
            SuiteError::Io { .. } | SuiteError::Record { .. } | SuiteError::Changed { .. } => {
                Self::new(ErrorKind::Io, error)
            }
            SuiteError::Child(_) => Self::new(ErrorKind::Internal, error),
        }
    }
}
