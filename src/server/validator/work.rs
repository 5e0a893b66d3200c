//! The work of a validation process.

use std::cell::RefCell;
use std::io::{self, BufRead, Write};
use std::path::Path;

use fled_core::cancel::CancelToken;
use fled_core::capture::video::{VideoError, Wanted, take_frames};
use fled_core::capture::{DecodeBudget, Look, Watch, limit_reader};
use fled_core::group::guarded;
use fled_core::image::{Image, ImageError, Srgb};

use super::words::{AssessReply, AssessRequest, Filming, VideoFault, VideoFaultKind};
use crate::files::data::thumbnail;
use crate::validation::{self, CaptureReport};

/// Long side of a thumbnail, px.
const THUMBNAIL_SIDE: usize = 240;

/// Validates the upload and prints replies on standard output; `answers` come from the service.
///
/// # Errors
/// When the service has gone, or the system refuses the limits.
pub fn assess(request: &AssessRequest, answers: &mut dyn BufRead) -> io::Result<()> {
    limit_reader(request.memory)?;
    if let Some(video) = &request.video {
        match film(video, request.room) {
            Ok(report) => say(&AssessReply::Filmed(report))?,
            Err(error) => return say(&AssessReply::NotFilmed(fault(&error))),
        }
    }
    match validation::unpacked_bytes(&request.dir) {
        Ok(bytes) if bytes > request.room => return say(&AssessReply::NoRoom),
        Ok(_) => {}
        Err(refusal) => return say(&AssessReply::Refused(*refusal)),
    }
    let answers = RefCell::new(answers);
    let watch = Watch {
        lend: &|bytes| DecodeBudget::new(borrow(bytes, &mut **answers.borrow_mut())),
        tell: &|look| {
            let reply = match look {
                Look::Begins(name) => AssessReply::Begins(name.to_owned()),
                Look::Ended(name) => AssessReply::Ended(name.to_owned()),
                Look::Seen(name, file, small) => {
                    if let Err(error) = keep_small(&request.dir, name, file, small) {
                        eprintln!("{name} has no thumbnail: {error}");
                    }
                    return;
                }
            };
            // If the pipe is closed, the service has gone and this process will end too.
            let _ = say(&reply);
        },
    };
    let (report, last) = match validation::examine(&request.dir, &watch) {
        Ok(mut report) => {
            let last = AssessReply::Accepted {
                accepted: report.accepted,
                warnings: std::mem::take(&mut report.warnings),
            };
            (report, last)
        }
        Err(refusal) if refusal.is_full => return say(&AssessReply::Full),
        Err(mut refusal) => {
            let accepted = refusal.report.accepted;
            let report = std::mem::take(&mut refusal.report);
            refusal.report.accepted = accepted;
            (report, AssessReply::Refused(*refusal))
        }
    };
    say_images(report)?;
    say(&last)
}

/// Writes a photograph's thumbnail, and a file with the photograph's path.
fn keep_small(dir: &Path, name: &str, file: &Path, small: &Image<Srgb>) -> Result<(), ImageError> {
    let path = dir.join(thumbnail(name));
    let folder = path.parent().unwrap_or(dir);
    let failed = |source| ImageError::Io { path: folder.to_owned(), source };
    std::fs::create_dir_all(folder).map_err(failed)?;
    let place = file.strip_prefix(dir).unwrap_or(file);
    std::fs::write(path.with_extension("txt"), place.as_os_str().as_encoded_bytes())
        .map_err(failed)?;
    let scale = THUMBNAIL_SIDE as f64 / small.width().max(small.height()) as f64;
    let side = |length: usize| ((length as f64 * scale.min(1.0)).round() as usize).max(1);
    small.resize_area(side(small.width()), side(small.height())).save(&path)
}

fn film(video: &Filming, room: u64) -> Result<String, VideoError> {
    let name = video.file.file_name().unwrap_or_default().to_string_lossy();
    let stem = video.file.file_stem().unwrap_or_default().to_string_lossy();
    let wanted = Wanted { count: video.frames, into: &video.into, stem: &stem, room };
    // FFmpeg must not outlive this process.
    let command = guarded(&video.ffmpeg)
        .map_err(|source| VideoError::Io { path: "the running program".into(), source })?;
    let taken = take_frames(&command, &video.file, &wanted, &CancelToken::new())?;
    Ok(taken.summary(&name))
}

fn fault(error: &VideoError) -> VideoFault {
    VideoFault {
        kind: match error {
            VideoError::Missing { .. } => VideoFaultKind::Missing,
            VideoError::NoRoom { .. } => VideoFaultKind::NoRoom,
            VideoError::Io { .. } => VideoFaultKind::Ours,
            _ => VideoFaultKind::Video,
        },
        detail: error.to_string(),
        hint: error.hint().to_owned(),
    }
}

/// Requests memory and waits for it. Returns the bytes granted.
fn borrow(bytes: u64, answers: &mut dyn BufRead) -> u64 {
    let mut answer = String::new();
    let asked = say(&AssessReply::Needs(bytes)).and_then(|()| answers.read_line(&mut answer));
    match asked.map(|_| answer.trim().parse()) {
        Ok(Ok(bytes)) => bytes,
        // The service has gone, and this process will end too; with 0, photographs are decoded one
        // at a time.
        _ => 0,
    }
}

fn say_images(report: CaptureReport) -> io::Result<()> {
    let mut images = report.images.into_iter();
    images.try_for_each(|image| say(&AssessReply::Image(image)))
}

/// Prints and flushes one line.
fn say(reply: &AssessReply) -> io::Result<()> {
    let line = serde_json::to_string(reply)?;
    let mut out = io::stdout().lock();
    writeln!(out, "{line}")?;
    out.flush()
}
