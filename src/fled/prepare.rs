//! `fled prepare`: reads the files of a capture, in a process of its own. A decoder that crashes or
//! takes much memory ends this process, not the run that waits for it.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

use clap::builder::RangedU64ValueParser;
use fled_capture::group::Group;
use fled_core::cancel::CancelToken;
use fled_core::capture::video::{self, FRAMES, MOST_FRAMES, VideoError, Wanted};
use fled_core::capture::{
    Assessment, Capture, CaptureError, Look, MIN_VIEWS, PHOTOGRAPH_TIME, PREPARED_SIDE, Watch,
    limit_reader, reader_memory,
};
use fled_core::event::ProgressSink;
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::pipeline::workspace::fingerprint;
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};

use crate::failure::{Failure, io};
use crate::tools;

/// How often a waiting run checks whether it was cancelled.
const LOOK: Duration = Duration::from_millis(100);

/// The hint for a photograph that crashes its decoder or keeps it busy.
const SAVE_ANEW: &str =
    "Remove it from the capture or save it in another format, if memory has not run out.";

/// The signals of a crash: SIGILL, SIGABRT, SIGFPE and SIGSEGV.
const CRASHES: [i32; 4] = [4, 6, 8, 11];

/// Arguments of `fled prepare`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Where the prepared capture goes: a new folder, or that of an earlier preparation.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Longest side of the prepared images, px.
    #[arg(long, value_name = "PX", default_value_t = PREPARED_SIDE,
        value_parser = RangedU64ValueParser::<usize>::from(64..=16_384))]
    size: usize,
    /// Progress as JSON lines on standard output.
    #[arg(long)]
    json: bool,
    /// Keep the photographs taken from a video for another preparation.
    #[arg(long)]
    keep_frames: bool,
}

/// What is read.
#[derive(clap::Args)]
pub struct Source {
    /// A folder or zip of photographs, or a video (MP4, MOV); a run also takes a folder that `fled
    /// prepare` made.
    pub capture: PathBuf,
    /// Photographs to take of a video: of every stretch the sharpest frame.
    #[arg(long, value_name = "N", default_value_t = FRAMES,
        value_parser = RangedU64ValueParser::<usize>::from(MIN_VIEWS as u64..=MOST_FRAMES as u64))]
    frames: usize,
    #[command(flatten)]
    ffmpeg: tools::Ffmpeg,
}

/// A line of `fled prepare --json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Message {
    /// A file is being read.
    Begins { name: String },
    /// It has been read, successfully or not.
    Ended { name: String },
    /// Something that the user should know, beyond what the manifest holds.
    Warning { code: String, message: String },
    /// A line for the log.
    Log { message: String },
    /// The capture is prepared. The last message.
    Prepared,
    /// The capture is not prepared. The last message.
    Failed { kind: ErrorKind, detail: String, hint: String, assessments: Vec<Assessment> },
}

/// Prepares a capture.
///
/// # Errors
/// [`Failure`], with the exit code of its kind.
pub fn main(args: &Args) -> Result<(), Failure> {
    let cancel = tools::cancel_on_signals()?;
    let is_json = args.json;
    let spinner = if is_json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    let shown = spinner.clone();
    let report = move |message: Message| match message {
        message if is_json => print(&message),
        Message::Begins { name } => shown.set_message(format!("reading {name}")),
        Message::Warning { code, message } => {
            shown.suspend(|| eprintln!("warning ({code}): {message}"));
        }
        Message::Log { message } => shown.suspend(|| eprintln!("{message}")),
        _ => {}
    };
    let outcome = prepare(args, &report, &cancel);
    spinner.finish_and_clear();
    match outcome {
        Ok(capture) => {
            if !is_json {
                unused(&capture.assessments).for_each(|line| eprintln!("{line}"));
                let (used, all) = (capture.views.len(), capture.assessments.len());
                eprintln!("{used} of {all} photographs are prepared in {}", args.out.display());
            }
            report(Message::Prepared);
            Ok(())
        }
        Err((failure, assessments)) => {
            if !is_json {
                unused(&assessments).for_each(|line| eprintln!("{line}"));
            }
            let (kind, detail, hint) = (failure.kind, failure.detail.clone(), failure.hint.clone());
            report(Message::Failed { kind, detail, hint, assessments });
            if is_json {
                // The reader of the message reports it.
                std::process::exit(kind.exit_code().into());
            }
            Err(failure)
        }
    }
}

fn print(message: &Message) {
    if let Ok(line) = serde_json::to_string(message) {
        let mut out = std::io::stdout().lock();
        // A reader that has gone needs no more lines.
        let _ = writeln!(out, "{line}").and_then(|()| out.flush());
    }
}

/// A line for each photograph that is not used.
fn unused(assessments: &[Assessment]) -> impl Iterator<Item = String> {
    assessments.iter().filter_map(|Assessment { name, reason, .. }| {
        reason.as_ref().map(|reason| format!("{name} is not used: {reason}"))
    })
}

fn prepare(
    args: &Args,
    report: &(dyn Fn(Message) + Sync),
    cancel: &CancelToken,
) -> Result<Capture, (Failure, Vec<Assessment>)> {
    let source = &args.source;
    let refused = |error: CaptureError| (PipelineError::from(error).into(), Vec::new());
    Capture::expect_free(&args.out).map_err(refused)?;
    let photographs = if source.capture.is_file() && video::is_video(&source.capture) {
        frames(source, &args.out, report, cancel).map_err(|failure| (failure, Vec::new()))?
    } else {
        source.capture.clone()
    };
    let tell = |look: Look<'_>| match look {
        Look::Begins(_) if cancel.is_cancelled() => {
            // The next preparation clears what this one leaves.
            let failure = Failure::new(ErrorKind::Cancelled, "cancelled");
            report(Message::Failed {
                kind: failure.kind,
                detail: failure.detail.clone(),
                hint: failure.hint.clone(),
                assessments: Vec::new(),
            });
            failure.report();
            std::process::exit(failure.kind.exit_code().into());
        }
        Look::Begins(name) => report(Message::Begins { name: name.to_owned() }),
        Look::Ended(name) => report(Message::Ended { name: name.to_owned() }),
        Look::Seen(..) => {}
    };
    // ffmpeg, which has read the video by now, has limits of its own.
    limit_reader(reader_memory(args.size))
        .map_err(|error| (Failure::new(ErrorKind::Environment, error), Vec::new()))?;
    let watch = Watch { tell: &tell, ..Watch::silent() };
    let capture = Capture::prepare(&photographs, &args.out, args.size, &watch);
    if !args.keep_frames {
        Capture::discard_frames(&args.out);
    }
    capture.map_err(|error| {
        let assessments = match &error {
            CaptureError::TooFew { assessments, .. } => assessments.clone(),
            _ => Vec::new(),
        };
        (PipelineError::from(error).into(), assessments)
    })
}

/// The folder with the photographs taken from a video; reuses one already made by this build.
fn frames(
    source: &Source,
    out: &Path,
    report: &dyn Fn(Message),
    cancel: &CancelToken,
) -> Result<PathBuf, Failure> {
    let video = &source.capture;
    let mut hasher = blake3::Hasher::new();
    let file = File::open(video).map_err(io(video))?;
    hasher.update_reader(file).map_err(io(video))?;
    let digest = hasher.finalize().to_hex();
    let name = fingerprint(&[&source.frames.to_string(), &digest]);
    let folder = Capture::frames(out, &name[..16]);
    if folder.is_dir() {
        return Ok(folder);
    }
    let unfinished = Capture::frames(out, "unfinished");
    if unfinished.exists() {
        fs::remove_dir_all(&unfinished).map_err(io(&unfinished))?;
    }
    let name = video.file_name().unwrap_or_default().to_string_lossy();
    let wanted = Wanted { count: source.frames, into: &unfinished, stem: "frame", room: u64::MAX };
    let taken = video::take_frames(&source.ffmpeg.command()?, video, &wanted, cancel)?;
    let message = taken.summary(&name);
    report(match taken.hdr {
        Some(_) => Message::Warning { code: "video".to_owned(), message },
        None => Message::Log { message },
    });
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

/// The capture, prepared in `out` by a child process with images of at most `side` px; one that was
/// given prepared is used as it is.
///
/// # Errors
/// [`Failure`] of the child, or when it dies.
pub fn open(
    source: &Source,
    out: &Path,
    side: usize,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<Capture, Failure> {
    let capture = if Capture::is_prepared(&source.capture) {
        let capture = Capture::given(&source.capture).map_err(PipelineError::from)?;
        capture.expect_side(side).map_err(PipelineError::from)?;
        capture
    } else {
        let program = std::env::current_exe().map_err(|e| Failure::new(ErrorKind::Internal, e))?;
        let mut command = Command::new(program);
        command.args(["prepare", "--json", "--keep-frames"]);
        command.args(["--size", &side.to_string(), "--frames", &source.frames.to_string()]);
        command.arg(option("--out=", out)).arg(option("--ffmpeg=", &source.ffmpeg.program));
        command.arg("--").arg(&source.capture);
        follow(&mut command, PHOTOGRAPH_TIME, sink, cancel)?;
        Capture::prepared(out).map_err(PipelineError::from)?
    };
    show(&capture.assessments, sink);
    for warning in &capture.warnings {
        sink.warn(&warning.code, warning.message.clone());
    }
    Ok(capture)
}

/// An option whose value may begin with a hyphen.
fn option(name: &str, value: &Path) -> OsString {
    let mut option = OsString::from(name);
    option.push(value);
    option
}

/// Reports unused photographs with the reason, and the warnings of each photograph.
fn show(assessments: &[Assessment], sink: &mut dyn ProgressSink) {
    unused(assessments).for_each(|line| sink.warn("unused", line));
    for Assessment { name, warnings, .. } in assessments {
        for warning in warnings {
            sink.warn(&warning.code, format!("{name}: {}", warning.message));
        }
    }
}

/// Runs the child to its end; a photograph that takes longer than `patience` ends it.
fn follow(
    command: &mut Command,
    patience: Duration,
    sink: &mut dyn ProgressSink,
    cancel: &CancelToken,
) -> Result<(), Failure> {
    let internal = |e: std::io::Error| Failure::new(ErrorKind::Internal, e);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
    let mut child = Group::spawn(command).map_err(internal)?;
    let (stdout, _) = child.outputs();
    let (sender, messages) = mpsc::channel::<Message>();
    std::thread::spawn(move || {
        let lines = BufReader::new(stdout.expect("piped")).lines().map_while(Result::ok);
        let messages = lines.filter_map(|line| serde_json::from_str(&line).ok());
        // The receiver goes only after the child.
        messages.map_while(|message| sender.send(message).ok()).for_each(drop);
    });
    let mut in_work: Vec<(String, Instant)> = Vec::new();
    loop {
        if cancel.is_cancelled() {
            child.kill();
            return Err(Failure::new(ErrorKind::Cancelled, "cancelled"));
        }
        match messages.recv_timeout(LOOK) {
            Ok(Message::Begins { name }) => in_work.push((name, Instant::now())),
            Ok(Message::Ended { name }) => {
                let at = in_work.iter().position(|(begun, _)| *begun == name);
                at.map(|at| in_work.swap_remove(at));
            }
            Ok(Message::Warning { code, message }) => sink.warn(&code, message),
            Ok(Message::Log { message }) => sink.log(message),
            Ok(Message::Prepared) => return child.wait().map(drop).map_err(internal),
            Ok(Message::Failed { kind, detail, hint, assessments }) => {
                child.wait().map_err(internal)?;
                show(&assessments, sink);
                return Err(Failure { hint, ..Failure::new(kind, detail) });
            }
            // Only when all that it wrote is read: this process may have been stopped meanwhile.
            Err(RecvTimeoutError::Timeout) => {
                let is_late = |(_, begun): &&(String, Instant)| begun.elapsed() > patience;
                if let Some((name, _)) = in_work.iter().find(is_late) {
                    child.kill();
                    return Err(endless(name, patience));
                }
            }
            Err(RecvTimeoutError::Disconnected) => {
                let names: Vec<String> = in_work.into_iter().map(|(name, _)| name).collect();
                return Err(died(child.wait().map_err(internal)?, &names));
            }
        }
    }
}

/// The failure for a photograph that takes longer than `patience`.
fn endless(name: &str, patience: Duration) -> Failure {
    let detail = format!("reading {name} did not finish within {} s", patience.as_secs());
    Failure {
        hint: "Remove it from the capture, or save it in another format.".to_owned(),
        ..Failure::new(ErrorKind::BadInput, detail)
    }
}

/// The failure for a child that ended without a last word.
fn died(status: ExitStatus, in_work: &[String]) -> Failure {
    let during = match in_work {
        [] => "the capture".to_owned(),
        names => names.join(" and "),
    };
    let detail =
        format!("the process that reads photographs ended ({status}) while reading {during}");
    let is_crash = status.signal().is_some_and(|signal| CRASHES.contains(&signal));
    let (kind, hint) = match (status.signal(), in_work) {
        (Some(9), _) => (ErrorKind::OomHost, "Memory may have run out: close other programs."),
        (_, [_, ..]) if is_crash => (ErrorKind::BadInput, SAVE_ANEW),
        _ => (ErrorKind::Internal, ErrorKind::Internal.hint()),
    };
    Failure { hint: hint.to_owned(), ..Failure::new(kind, detail) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fled_core::event::{Event, Silent};

    fn run(script: &str, sink: &mut dyn ProgressSink) -> Result<(), Failure> {
        let patience = Duration::from_secs(1);
        follow(Command::new("sh").args(["-c", script]), patience, sink, &CancelToken::new())
    }

    #[test]
    fn a_reader_that_dies_names_the_photographs_in_work() {
        let begins = |name: &str| format!(r#"echo '{{"event":"begins","name":"{name}"}}'; "#);
        let script = begins("a.jpg") + r#"echo '{"event":"ended","name":"a.jpg"}'; "#;
        let script = script + &begins("b.jpg") + "kill -ABRT $$";
        let failure = run(&script, &mut Silent).expect_err("it died");
        assert_eq!(failure.kind, ErrorKind::BadInput);
        assert!(failure.detail.contains("while reading b.jpg"), "{}", failure.detail);
        let failure = run(&format!("{} sleep 60", begins("c.jpg")), &mut Silent);
        let failure = failure.expect_err("it takes too long");
        assert_eq!(failure.kind, ErrorKind::BadInput);
        assert_eq!(failure.detail, "reading c.jpg did not finish within 1 s");
        let failure = run("kill -KILL $$", &mut Silent).expect_err("it died");
        assert_eq!(failure.kind, ErrorKind::OomHost);
        let failure = run("exit 0", &mut Silent).expect_err("no last word");
        assert_eq!(failure.kind, ErrorKind::Internal);
    }

    #[test]
    fn warnings_and_failures_of_the_reader_are_passed_on() {
        let mut seen = Vec::new();
        let mut sink = |event: &Event| seen.push(format!("{event:?}"));
        let warning = r#"{"event":"warning","code":"video","message":"HDR"}"#;
        let failed = concat!(
            r#"{"event":"failed","kind":"bad_input","detail":"too few","hint":"more","#,
            r#""assessments":[]}"#
        );
        let failure = run(&format!("echo '{warning}'; echo '{failed}'; exit 3"), &mut sink);
        let failure = failure.expect_err("it failed");
        assert_eq!((failure.kind, &*failure.detail), (ErrorKind::BadInput, "too few"));
        assert_eq!(failure.hint, "more");
        assert_eq!(seen.len(), 1, "{seen:?}");
        run(r#"echo '{"event":"prepared"}'"#, &mut Silent).expect("prepared");
    }

    #[test]
    fn a_cancelled_run_waits_neither_for_a_silent_nor_for_a_busy_reader() {
        let busy = r#"while :; do echo '{"event":"ended","name":"a"}'; done"#;
        for script in ["sleep 30", busy] {
            let cancel = CancelToken::new();
            cancel.cancel();
            let begun = Instant::now();
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            let outcome = follow(&mut command, PHOTOGRAPH_TIME, &mut Silent, &cancel);
            assert_eq!(outcome.expect_err("cancelled").kind, ErrorKind::Cancelled);
            assert!(begun.elapsed().as_secs() < 10);
        }
    }
}
