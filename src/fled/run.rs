//! `fled run`: one capture, no server.

use std::fs::{self, OpenOptions};
use std::path::PathBuf;

use fled_core::cancel::CancelToken;
use fled_core::capture::PREPARED_SIDE;
use fled_core::event::ProgressSink;
use fled_core::pipeline;
use fled_core::pipeline::config::{Options, Preset};
use fled_core::pipeline::error::PipelineError;
use fled_core::pipeline::workspace::Workspace;
use serde_json::{Map, Value};

use crate::failure::{Failure, io};
use crate::prepare;
use crate::progress::Reporter;
use crate::tools;

/// Arguments of `fled run`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    source: prepare::Source,
    /// Where the result goes.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// auto (high on a GPU with at least 6 GB of memory, else standard), preview, standard, high or
    /// paper [default: auto, or standard with --options].
    #[arg(long)]
    preset: Option<Preset>,
    /// One option over the preset's; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// A JSON object of options over the preset's, before any `--set`.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
    /// Events as JSON lines on standard output.
    #[arg(long)]
    json: bool,
    /// Remove what only another run into the same folder, with other options, would use again:
    /// the prepared capture and the deblurred views in full precision.
    #[arg(long)]
    discard_work: bool,
    #[command(flatten)]
    tools: tools::Args,
}

/// How far a run goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Up to the poses.
    Poses,
    /// To the end.
    Whole,
}

/// Runs the pipeline.
///
/// # Errors
/// [`Failure`], with the exit code of its kind.
pub fn main(args: &Args, extent: Extent) -> Result<(), Failure> {
    let options = options(args)?;
    let workspace = Workspace::open(&args.out)?;
    let path = workspace.folder().log();
    let log = OpenOptions::new().create(true).append(true).open(&path).map_err(io(&path))?;
    let mut reporter = Reporter::new(log, args.json);
    let cancel = tools::cancel_on_signals()?;
    let outcome = run(args, extent, &options, &workspace, &mut reporter, &cancel);
    if let Err(failure) = &outcome {
        reporter.event(&failure.event());
    }
    outcome
}

fn run(
    args: &Args,
    extent: Extent,
    options: &Options,
    workspace: &Workspace,
    reporter: &mut Reporter,
    cancel: &CancelToken,
) -> Result<(), Failure> {
    // The file also marks this folder as no part of a capture, should it lie inside one.
    workspace.write_json(&workspace.folder().config(), options)?;
    let device = tools::device(options)?;
    if extent == Extent::Whole {
        // Before the photographs are read, which takes minutes.
        pipeline::check_detail(options, &device.facts()).map_err(PipelineError::from)?;
    }
    let side = PREPARED_SIDE.max(options.longest_side() as usize);
    let out = workspace.folder().work().prepared();
    let capture = prepare::open(&args.source, &out, side, reporter, cancel)?;
    let mut kit = tools::Kit::new(&args.tools, options, device, &capture)?;
    let mut tools = kit.tools();
    match extent {
        Extent::Poses => {
            pipeline::find_poses(&capture, options, &mut tools, workspace, reporter, cancel)?;
        }
        Extent::Whole => {
            pipeline::run(&capture, options, &mut tools, workspace, reporter, cancel)?;
            workspace.discard_prepared()?;
        }
    }
    if args.discard_work {
        workspace.discard_intermediates()?;
    }
    Ok(())
}

fn options(args: &Args) -> Result<Options, Failure> {
    // A file of an older build has no detail: its numbers were those of `standard`.
    let usual = if args.options.is_some() { Preset::Standard } else { Preset::Auto };
    let mut options = args.preset.unwrap_or(usual).options();
    if let Some(path) = &args.options {
        let bytes = fs::read(path).map_err(io(path))?;
        let mut overrides: Map<String, Value> = serde_json::from_slice(&bytes)
            .map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
        overrides.retain(|key, _| !is_retired(key));
        options = options.with_overrides(&overrides)?;
    }
    for assignment in &args.assignments {
        let key = assignment.split('=').next().unwrap_or_default();
        if !is_retired(key) {
            options = options.with_assignment(assignment)?;
        }
    }
    pipeline::check_minutes(&options)?;
    Ok(options)
}

/// Whether the option is one of earlier builds; warns about it.
fn is_retired(key: &str) -> bool {
    let retired = Options::is_retired(key);
    if retired {
        eprintln!("warning: fled no longer has the option `{key}`; it is ignored");
    }
    retired
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use fled_core::pipeline::config::Detail;

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_file_of_options_goes_over_standard_unless_a_preset_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("config.json");
        fs::write(&file, r#"{ "seed": 3 }"#).expect("a file");
        let file = file.to_str().expect("a path");
        let of = |more: &[&str]| {
            let command = [&["run", "capture", "--out", "result"], more].concat();
            options(&Command::parse_from(command).args).expect("options")
        };
        let old = of(&["--options", file]);
        assert_eq!((old.detail, old.seed), (Detail::Standard, 3));
        assert_eq!(of(&["--options", file, "--preset", "auto"]).detail, Detail::Auto);
        assert_eq!(of(&[]).detail, Detail::Auto);
    }
}
