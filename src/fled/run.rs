//! `fled run`: one capture, no server.

use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};

use clap::builder::RangedU64ValueParser;
use fled_core::cancel::CancelToken;
use fled_core::capture::video::{self, FRAMES, MOST_FRAMES, VideoError, Wanted};
use fled_core::capture::{Assessment, Capture, CaptureError, MIN_VIEWS, PREPARED_SIDE};
use fled_core::event::ProgressSink;
use fled_core::pipeline;
use fled_core::pipeline::config::{Options, Preset};
use fled_core::pipeline::error::ErrorKind;
use fled_core::pipeline::workspace::{Workspace, fingerprint};
use serde_json::{Map, Value};

use crate::failure::{Failure, io};
use crate::progress::Reporter;
use crate::tools;

/// Arguments of `fled run`.
#[derive(clap::Args)]
pub struct Args {
    /// A folder or zip of photographs, or a video (MP4, MOV).
    capture: PathBuf,
    /// Where the result goes.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// preview, standard or paper.
    #[arg(long, default_value = "standard")]
    preset: Preset,
    /// One option over the preset's; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// A JSON object of options over the preset's, before any `--set`.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
    /// Photographs to take of a video: of every stretch the sharpest frame.
    #[arg(long, value_name = "N", default_value_t = FRAMES,
        value_parser = RangedU64ValueParser::<usize>::from(MIN_VIEWS as u64..=MOST_FRAMES as u64))]
    frames: usize,
    /// Events as JSON lines on standard output.
    #[arg(long)]
    json: bool,
    /// Remove what only another run into the same folder, with other options, would use again:
    /// the unpacked capture and the deblurred views in full precision.
    #[arg(long)]
    discard_work: bool,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
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
    let scratch = workspace.folder().work().capture();
    let photographs = if args.capture.is_file() && video::is_video(&args.capture) {
        &frames(args, &scratch, reporter, cancel)?
    } else {
        &args.capture
    };
    let side = PREPARED_SIDE.max(options.longest_side() as usize);
    let opened = Capture::open_at(photographs, &scratch, side);
    match &opened {
        Ok(Capture { assessments, .. }) | Err(CaptureError::TooFew { assessments, .. }) => {
            report(assessments, reporter);
        }
        Err(_) => {}
    }
    let capture = opened.map_err(pipeline::error::PipelineError::from)?;
    for warning in &capture.warnings {
        reporter.warn(&warning.code, warning.message.clone());
    }
    let mut kit = tools::Kit::new(&args.tools, options, &capture)?;
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

/// Reports unused photographs with the reason, and the warnings of each photograph.
fn report(assessments: &[Assessment], reporter: &mut Reporter) {
    for Assessment { name, reason, warnings, .. } in assessments {
        if let Some(reason) = reason {
            reporter.warn("unused", format!("{name} is not used: {reason}"));
        }
        for warning in warnings {
            reporter.warn(&warning.code, format!("{name}: {}", warning.message));
        }
    }
}

fn options(args: &Args) -> Result<Options, Failure> {
    let mut options = args.preset.options();
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

/// The folder with the photographs taken from a video; reuses one already made by this build.
fn frames(
    args: &Args,
    scratch: &Path,
    reporter: &mut Reporter,
    cancel: &CancelToken,
) -> Result<PathBuf, Failure> {
    let video = &args.capture;
    let mut hasher = blake3::Hasher::new();
    let file = File::open(video).map_err(io(video))?;
    hasher.update_reader(file).map_err(io(video))?;
    let digest = hasher.finalize().to_hex();
    let name = fingerprint(&[&args.frames.to_string(), &digest]);
    let folder = scratch.join(format!("frames-{}", &name[..16]));
    if folder.is_dir() {
        return Ok(folder);
    }
    let unfinished = scratch.join("frames-unfinished");
    if unfinished.exists() {
        fs::remove_dir_all(&unfinished).map_err(io(&unfinished))?;
    }
    let name = video.file_name().unwrap_or_default().to_string_lossy();
    let wanted = Wanted { count: args.frames, into: &unfinished, stem: "frame", room: u64::MAX };
    let ffmpeg = args.ffmpeg.command()?;
    let taken = video::take_frames(&ffmpeg, video, &wanted, cancel)?;
    match taken.hdr {
        Some(_) => reporter.warn("video", taken.told(&name)),
        None => reporter.log(taken.told(&name)),
    }
    fs::rename(&unfinished, &folder).map_err(io(&folder))?;
    Ok(folder)
}

impl From<VideoError> for Failure {
    fn from(error: VideoError) -> Self {
        let kind = match error {
            VideoError::Missing { .. } => ErrorKind::Environment,
            VideoError::Timeout => ErrorKind::Timeout,
            VideoError::Cancelled(_) => ErrorKind::Cancelled,
            VideoError::Io { .. } | VideoError::NoRoom { .. } => ErrorKind::Io,
            _ => ErrorKind::BadInput,
        };
        Self { hint: error.hint().to_owned(), ..Self::new(kind, error) }
    }
}
