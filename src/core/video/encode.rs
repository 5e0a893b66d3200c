//! Pictures to H.264 in MP4, by ffmpeg.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf, absolute};
use std::process::{Child, ChildStdin, Stdio};

use crate::camera::Camera;
use crate::ffmpeg::{Words, command, last_line};
use crate::image::Image;

/// x264's measure of quality: no loss that one sees.
const QUALITY: &str = "18";

/// The matrix that players assume where a video is large, said for all of them, and 4:2:0, which
/// all of them show.
const COLOURS: &str = "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p";

/// Why there is no video.
#[derive(Debug, thiserror::Error)]
pub enum EncodeError {
    /// There is no ffmpeg.
    #[error("videos are written by ffmpeg, which cannot be started: {program}: {reason}")]
    Missing {
        /// What was started.
        program: String,
        /// What the system said.
        reason: String,
    },
    /// ffmpeg ended before the video did.
    #[error("ffmpeg wrote no video: {reason}")]
    Refused {
        /// The last that it said.
        reason: String,
    },
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
}

impl EncodeError {
    /// What to do about it.
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

/// Where a video goes and what writes it.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// ffmpeg.
    pub program: &'a Path,
    /// The file; it is there when it is whole.
    pub file: &'a Path,
    /// Pictures a second.
    pub fps: u32,
}

/// Writes a video of what `picture` makes of each camera's number and camera, all of one size.
///
/// # Errors
/// [`EncodeError`], and those of `picture`, which end it.
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

/// An ffmpeg that takes pictures; gone with what it wrote when it is dropped before its end.
struct Encoder {
    child: Child,
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
        let mut command = command(target.program, &[]);
        command
            .args(["-y", "-f", "rawvideo", "-pixel_format", "rgb24"])
            .args(["-video_size", &format!("{width}x{height}")])
            .args(["-framerate", &fps, "-i", "pipe:0", "-an", "-vf", COLOURS])
            .args(["-c:v", "libx264", "-preset", "medium", "-crf", QUALITY])
            .args(["-colorspace", "bt709", "-color_primaries", "bt709"])
            .args(["-color_trc", "bt709", "-color_range", "tv"])
            // What a player needs first comes first, so that it begins before all is there.
            .args(["-movflags", "+faststart", "-f", "mp4"])
            .arg(&file)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        // In our own process group: whoever ends us with it ends it, too.
        let mut child = command.spawn().map_err(|source| EncodeError::Missing {
            program: target.program.display().to_string(),
            reason: source.to_string(),
        })?;
        Ok(Self {
            pictures: child.stdin.take(),
            words: Words::of(child.stderr.take()),
            child,
            file,
            is_whole: false,
        })
    }

    fn take(&mut self, picture: &Image) -> Result<(), EncodeError> {
        let written = match &mut self.pictures {
            Some(pictures) => pictures.write_all(&picture.to_rgb8()),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        };
        // It has ended, and says why.
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
        // One that takes no more has nothing more to do.
        let _ = self.child.kill();
        let reason = last_line(&self.words.all(&self.file)).to_owned();
        EncodeError::Refused { reason }
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        if self.is_whole {
            return;
        }
        // It may have ended, and have written nothing; what counts is that nothing is left.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = fs::remove_file(&self.file);
    }
}
