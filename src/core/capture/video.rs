//! A video as photographs: of every stretch the sharpest frame.
//!
//! ffmpeg reads it twice, as a process of its own: once small and grey, which is enough to tell how
//! sharp each frame is, and once for those that were chosen.

mod choose;
mod ffmpeg;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use self::choose::{Stretches, sharpness};
use self::ffmpeg::{Ffmpeg, Output};
use crate::cancel::{CancelToken, Cancelled};
use crate::image::read_header;

/// Frames that are taken when nobody says how many.
pub const FRAMES: usize = 40;

/// Most frames that are taken.
pub const MOST_FRAMES: usize = 500;

/// Most frames of a video: ten minutes at 60 a second.
const MOST_IN_VIDEO: usize = 36_000;

/// Frames of a larger video are brought down to this long side, px, by area: no preset trains on
/// more, and noise is averaged.
const LONG_SIDE: usize = 1920;

/// Side of the square in which sharpness is measured, px. What is compared has one shape anyway.
const MEASURED_SIDE: usize = 320;

/// Most pixels of a frame that is decoded.
const MOST_PIXELS: usize = 40_000_000;

/// How long ffmpeg may take in all. Who waits for an answer to an upload waits ten minutes.
const PATIENCE: Duration = Duration::from_secs(8 * 60);

/// Why no photographs come of a video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// There is no ffmpeg.
    #[error("{program}: {reason}; videos are read by ffmpeg")]
    Missing {
        /// What was started.
        program: String,
        /// What the system said.
        reason: String,
    },
    /// ffmpeg cannot read it.
    #[error("the video cannot be read: {reason}")]
    Unreadable {
        /// The last that ffmpeg said.
        reason: String,
    },
    /// It is too short.
    #[error(
        "the video has {frames} frames, at least {} are needed",
        super::MIN_VIEWS
    )]
    TooShort {
        /// How many it has.
        frames: usize,
    },
    /// It is too long.
    #[error("the video has more than {MOST_IN_VIDEO} frames")]
    TooLong,
    /// Its frames would take more than there is room for.
    #[error("the photographs may take {bytes} bytes, more than there is room for")]
    NoRoom {
        /// What they may take.
        bytes: u64,
    },
    /// ffmpeg took too long.
    #[error("ffmpeg was stopped after {} minutes", PATIENCE.as_secs() / 60)]
    Timeout,
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
}

impl VideoError {
    /// What to do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Missing { .. } => {
                "install it (apt-get install ffmpeg), or give photographs of the video"
            }
            Self::Unreadable { .. } => "give it as MP4 or MOV that other players show, whole",
            Self::TooShort { .. } => "walk around the scene, slowly, for half a minute or more",
            Self::TooLong => "cut it: ten minutes at 60 frames a second are read",
            Self::NoRoom { .. } => "ask for fewer frames, or make room",
            Self::Timeout => "cut it into parts, or make it smaller",
            Self::Cancelled(_) => "",
            Self::Io { .. } => "check that the disk is not full",
        }
    }

    fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}

/// What is wanted of a video.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// Frames; there may be fewer.
    pub count: usize,
    /// The folder for them.
    pub into: &'a Path,
    /// How their names begin.
    pub stem: &'a str,
    /// What they may take on the disk, bytes.
    pub room: u64,
}

/// What was taken of a video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Frames that it has.
    pub frames: usize,
    /// The files of those taken, in order; each has the number of its frame, from 0, in its name.
    pub files: Vec<PathBuf>,
}

impl Taken {
    /// A sentence for who gave the video, which they call `name`.
    pub fn told(&self, name: &str) -> String {
        format!(
            "{} of the {} frames of {name} are used, the sharpest of every {:.0}",
            self.files.len(),
            self.frames,
            (self.frames as f64 / self.files.len() as f64).max(1.0)
        )
    }
}

/// Whether a file's name says that it is a video that is read.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    let known = ["mp4", "mov", "m4v"];
    extension.is_some_and(|extension| known.iter().any(|one| one.eq_ignore_ascii_case(extension)))
}

/// Writes the sharpest frames of `video` as PNG files.
///
/// # Errors
/// [`VideoError`]; what was written by then stays.
pub fn take_frames(
    program: &Path,
    video: &Path,
    wanted: &Wanted<'_>,
    cancel: &CancelToken,
) -> Result<Taken, VideoError> {
    let ffmpeg = Ffmpeg {
        program,
        video,
        cancel,
        until: Instant::now() + PATIENCE,
    };
    let sharpness = measure(&ffmpeg)?;
    if sharpness.len() < super::MIN_VIEWS {
        return Err(VideoError::TooShort {
            frames: sharpness.len(),
        });
    }
    let chosen = Stretches::of(sharpness.len(), wanted.count).sharpest(&sharpness);
    fs::create_dir_all(wanted.into).map_err(VideoError::io(wanted.into))?;
    // One says how large they all may be.
    let first = extract(&ffmpeg, &chosen[..1], wanted)?;
    let header = first.first().and_then(|file| read_header(file).ok());
    let bytes = header.map_or(0, |header| header.decoded_bytes) * chosen.len() as u64;
    if bytes > wanted.room {
        return Err(VideoError::NoRoom { bytes });
    }
    let files = extract(&ffmpeg, &chosen, wanted)?;
    Ok(Taken {
        frames: sharpness.len(),
        files,
    })
}

/// How sharp each frame is.
fn measure(ffmpeg: &Ffmpeg<'_>) -> Result<Vec<f32>, VideoError> {
    let side = MEASURED_SIDE;
    let filter = format!("scale={side}:{side}:flags=area,format=gray");
    let arguments = ["-vf", &filter, "-f", "rawvideo", "-"].map(str::to_owned);
    let mut measured = Vec::new();
    ffmpeg.run(
        &arguments,
        Output::Chunks(side * side, &mut |frame: &[u8]| {
            measured.push(sharpness(frame, side));
            measured.len() <= MOST_IN_VIDEO
        }),
    )?;
    if measured.len() > MOST_IN_VIDEO {
        return Err(VideoError::TooLong);
    }
    Ok(measured)
}

/// Writes the frames of these numbers, in order.
fn extract(
    ffmpeg: &Ffmpeg<'_>,
    chosen: &[usize],
    wanted: &Wanted<'_>,
) -> Result<Vec<PathBuf>, VideoError> {
    let select = format!("select='{}'", any_of(chosen));
    // Pixels that are not square, then those that are too many.
    let square = "scale='trunc(iw*sar)':ih:flags=area,setsar=1";
    let fit = "force_original_aspect_ratio=decrease:flags=area";
    let most = format!("scale='min(iw,{LONG_SIDE})':'min(ih,{LONG_SIDE})':{fit}");
    let filter = format!("{select},{square},{most}");
    // Numbers of ours until they are known to be all there; `%` means something to ffmpeg.
    let folder = wanted.into.join(".frames");
    match fs::remove_dir_all(&folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(VideoError::io(&folder)(error));
        }
        _ => fs::create_dir(&folder).map_err(VideoError::io(&folder))?,
    }
    let count = chosen.len().to_string();
    let arguments = [
        "-vf",
        &filter,
        "-frames:v",
        &count,
        "-f",
        "image2",
        "-c:v",
        "png",
        "%06d.png",
    ];
    ffmpeg.run(&arguments.map(str::to_owned), Output::Folder(&folder))?;
    let mut files = Vec::with_capacity(chosen.len());
    for (at, number) in chosen.iter().enumerate() {
        let from = folder.join(format!("{:06}.png", at + 1));
        let to = wanted.into.join(format!("{}-{number:06}.png", wanted.stem));
        match fs::rename(&from, &to) {
            // A video may lose frames on its second reading where it is damaged.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            moved => moved.map_err(VideoError::io(&to))?,
        }
        files.push(to);
    }
    fs::remove_dir_all(&folder).map_err(VideoError::io(&folder))?;
    Ok(files)
}

/// An expression that is true of the frames of these numbers. Balanced: ffmpeg reads no sum of more
/// than a hundred terms.
fn any_of(numbers: &[usize]) -> String {
    match numbers {
        [] => "0".to_owned(),
        [number] => format!("eq(n\\,{number})"),
        _ => {
            let (before, after) = numbers.split_at(numbers.len() / 2);
            format!("({}+{})", any_of(before), any_of(after))
        }
    }
}

#[cfg(test)]
mod tests;
