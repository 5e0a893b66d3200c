//! Encodes pictures as H.264 in MP4 with ffmpeg.

use std::ffi::OsString;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf, absolute};
use std::process::{ChildStdin, Stdio};
use std::time::Duration;

use crate::camera::Camera;
use crate::ffmpeg::{Words, command, is_not_started, last_line};
use crate::group::Group;
use crate::image::Image;

/// x264's quality: no visible loss.
const QUALITY: &str = "18";

/// The matrix that players assume for large videos, declared for all sizes, and 4:2:0, which all
/// players support.
const COLOURS: &str = "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p";

/// Why a video could not be written.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// There is no ffmpeg.
    #[error("videos are written by ffmpeg, which cannot be started: {program}: {reason}")]
    Missing {
        /// The command.
        program: String,
        /// The system's message.
        reason: String,
    },
    /// ffmpeg ended before the video did.
    #[error("ffmpeg wrote no video: {reason}")]
    Refused {
        /// Its last message.
        reason: String,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The path.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}

impl EncodeError {
    /// A remedy for the user.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Missing { .. } => "install it (apt-get install ffmpeg)",
            Self::Refused { .. } => {
                "it must know libx264, as Debian's does, and the disk must not be full"
            }
            Self::Io { .. } => "check that the disk is not full and the folder is there",
        }
    }
}

/// The output of a video and the program that writes it.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// ffmpeg, or a program that starts it with the arguments that follow, and exits with 127 if
    /// it is not found.
    pub command: &'a [OsString],
    /// The file; it exists only when complete.
    pub file: &'a Path,
    /// Pictures a second.
    pub fps: u32,
}

/// Writes a video of the pictures that `picture` makes from each camera and its number, all of one
/// size.
///
/// # Errors
/// [`EncodeError`], and errors of `picture`, which stop it.
pub fn write<E: From<EncodeError>>(
    target: &Target<'_>,
    cameras: &[Camera],
    mut picture: impl FnMut(usize, &Camera) -> Result<Image, E>,
) -> Result<(), E> {
    let Some(first) = cameras.first() else {
        let reason = "there are no pictures".to_owned();
        return Err(EncodeError::Refused { reason }.into());
    };
    let size = (first.intrinsics.width, first.intrinsics.height);
    let temporary = target.file.with_added_extension("tmp");
    let mut encoder = Encoder::start(target, size, &temporary)?;
    for (number, camera) in cameras.iter().enumerate() {
        encoder.take(&picture(number, camera)?)?;
    }
    encoder.finish()?;
    let renamed = fs::rename(&temporary, target.file).map_err(io_error(target.file));
    Ok(renamed?)
}

fn io_error(path: &Path) -> impl FnOnce(io::Error) -> EncodeError {
    let path = path.to_owned();
    move |source| EncodeError::Io { path, source }
}

/// An ffmpeg process that receives pictures; it and its output are removed if dropped early.
struct Encoder {
    child: Group,
    program: String,
    pictures: Option<ChildStdin>,
    words: Words,
    file: PathBuf,
    is_whole: bool,
}

impl Encoder {
    fn start(
        target: &Target<'_>,
        (width, height): (usize, usize),
        file: &Path,
    ) -> Result<Self, EncodeError> {
        // A name may begin like an option.
        let file = absolute(file).map_err(io_error(file))?;
        let fps = target.fps.to_string();
        let program = target.command.last().map(|program| program.to_string_lossy());
        let program = program.unwrap_or_default().into_owned();
        let missing = |reason: String| EncodeError::Missing { program: program.clone(), reason };
        let Some((first, arguments)) = target.command.split_first() else {
            return Err(missing("no program is named".to_owned()));
        };
        let mut command = command(first, arguments);
        command
            .args(["-y", "-f", "rawvideo", "-pixel_format", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}")])
            .args(["-framerate", &fps, "-i", "pipe:0", "-an", "-vf", COLOURS])
            .args(["-c:v", "libx264", "-preset", "medium", "-crf", QUALITY])
            .args(["-colorspace", "bt709", "-color_primaries", "bt709"])
            .args(["-color_trc", "bt709", "-color_range", "tv"])
            // Put the index first, so players can start before the file is complete.
            .args(["-movflags", "+faststart", "-f", "mp4"])
            .arg(&file)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut child = Group::spawn(&mut command).map_err(|source| missing(source.to_string()))?;
        Ok(Self {
            pictures: child.input(),
            words: Words::of(child.outputs().1),
            child,
            program,
            file,
            is_whole: false,
        })
    }

    fn take(&mut self, picture: &Image) -> Result<(), EncodeError> {
        let written = match &mut self.pictures {
            Some(pictures) => pictures.write_all(&picture.to_rgb8()),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        };
        // It has exited with an error message.
        written.map_err(|_| self.refused())
    }

    fn finish(mut self) -> Result<(), EncodeError> {
        drop(self.pictures.take());
        let status = self.child.wait().map_err(io_error(&self.file))?;
        if !status.success() {
            return Err(self.refused());
        }
        self.is_whole = true;
        Ok(())
    }

    fn refused(&mut self) -> EncodeError {
        let reason = last_line(&self.words.all(&self.file)).to_owned();
        // It has closed its outputs, so it has ended or is about to.
        std::thread::sleep(Duration::from_millis(20));
        let is_missing =
            matches!(self.child.try_wait(), Ok(Some(s)) if s.code().is_some_and(is_not_started));
        // A process that accepts no more input has nothing left to do.
        self.child.kill();
        match is_missing {
            true => EncodeError::Missing { program: self.program.clone(), reason },
            false => EncodeError::Refused { reason },
        }
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        if self.is_whole {
            return;
        }
        // It may have exited without writing anything; only leave nothing behind.
        self.child.kill();
        let _ = fs::remove_file(&self.file);
    }
}
