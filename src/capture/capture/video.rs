//! A video as photographs: the sharpest frame of each segment.
//!
//! ffmpeg reads it in a separate process: first the beginning, to see how the frames are coded,
//! then the whole video small and grey, to measure sharpness, and last the chosen frames.

mod choose;
mod error;
mod ffmpeg;
mod range;
mod stream;

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use self::choose::{Segments, sharpness};
use self::error::{MOST_IN_VIDEO, PATIENCE};
use self::ffmpeg::{Ffmpeg, Output};
use self::stream::Stream;
use crate::cancel::CancelToken;
use crate::image::{Unread, read_header};

pub use self::error::VideoError;
pub use self::range::Hdr;

/// Default number of frames.
pub const FRAMES: usize = 40;

/// Maximum number of frames.
pub const MOST_FRAMES: usize = 500;

/// Larger frames are reduced to this long side, px, by area averaging: no preset trains on more,
/// and it averages noise.
const LONG_SIDE: usize = 1920;

/// Side of the square in which sharpness is measured, px. All compared frames have the same shape.
const MEASURED_SIDE: usize = 320;

/// A request for frames of a video.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// Number of frames; the result may have fewer.
    pub count: usize,
    /// The output folder.
    pub into: &'a Path,
    /// Prefix of their names.
    pub stem: &'a str,
    /// Disk space that they may take, bytes.
    pub room: u64,
}

/// The frames taken from a video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Number of frames in the video.
    pub frames: usize,
    /// The files written, in order; each name has the frame's number, from 0.
    pub files: Vec<PathBuf>,
    /// Treatment of a brightness range larger than sRGB.
    pub hdr: Option<Hdr>,
    /// Whether each frame combines two fields from different moments.
    pub is_interlaced: bool,
}

impl Taken {
    /// A sentence for the user, who knows the video as `name`.
    pub fn summary(&self, name: &str) -> String {
        let hdr = self.hdr.map_or(String::new(), |hdr| format!("; {hdr}"));
        let fields =
            if self.is_interlaced { "; it is interlaced and was deinterlaced" } else { "" };
        format!(
            "{} of the {} frames of {name} are used, the sharpest of every {:.0}{fields}{hdr}",
            self.files.len(),
            self.frames,
            (self.frames as f64 / self.files.len() as f64).max(1.0)
        )
    }
}

/// Whether a file has the name of a supported video.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    let known = ["mp4", "mov", "m4v"];
    extension.is_some_and(|extension| known.iter().any(|one| one.eq_ignore_ascii_case(extension)))
}

/// Writes the sharpest frames of `video` as PNG files. `command` is ffmpeg, or a program that
/// starts it with the arguments that follow; exit code 127 means that it was not found, as in
/// shells.
///
/// # Errors
/// [`VideoError`]; files written before the error remain.
pub fn take_frames(
    command: &[OsString],
    video: &Path,
    wanted: &Wanted<'_>,
    cancel: &CancelToken,
) -> Result<Taken, VideoError> {
    let ffmpeg = Ffmpeg { command, video, cancel, until: Instant::now() + PATIENCE };
    if let Some(format) = Unread::of(video).map_err(VideoError::io(video))? {
        return Err(VideoError::Unread(format));
    }
    let mut stream = Stream::of(&ffmpeg)?;
    let sharpness = measure(&ffmpeg, &stream)?;
    if sharpness.len() < super::error::MIN_VIEWS {
        return Err(VideoError::TooShort { frames: sharpness.len() });
    }
    let chosen = Segments::of(sharpness.len(), wanted.count).sharpest(&sharpness);
    fs::create_dir_all(wanted.into).map_err(VideoError::io(wanted.into))?;
    // The first frame gives the size for all, and whether this ffmpeg converts their range.
    let mut first = extract(&ffmpeg, &chosen[..1], wanted, &stream);
    if let (Some(found), Err(VideoError::Unreadable { .. })) = (stream.hdr, &first) {
        stream.hdr = Some(found.left());
        first = extract(&ffmpeg, &chosen[..1], wanted, &stream);
    }
    let first = first?;
    let header = first.first().and_then(|file| read_header(file).ok());
    let bytes = header.map_or(0, |header| header.decoded_bytes) * chosen.len() as u64;
    if bytes > wanted.room {
        return Err(VideoError::NoRoom { bytes });
    }
    let files = extract(&ffmpeg, &chosen, wanted, &stream)?;
    let Stream { hdr, is_interlaced, .. } = stream;
    Ok(Taken { frames: sharpness.len(), files, hdr, is_interlaced })
}

/// The sharpness of each frame.
fn measure(ffmpeg: &Ffmpeg<'_>, stream: &Stream) -> Result<Vec<f32>, VideoError> {
    let side = MEASURED_SIDE;
    let filter = format!("{}scale={side}:{side}:flags=area,format=gray", stream.first);
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

/// Writes the frames with these numbers, in order.
fn extract(
    ffmpeg: &Ffmpeg<'_>,
    chosen: &[usize],
    wanted: &Wanted<'_>,
    stream: &Stream,
) -> Result<Vec<PathBuf>, VideoError> {
    let select = format!("select='{}'", any_of(chosen));
    // Make pixels square, then reduce the size.
    let square = "scale='trunc(iw*sar)':ih:flags=area,setsar=1";
    let fit = "force_original_aspect_ratio=decrease:flags=area";
    let most = format!("scale='min(iw,{LONG_SIDE})':'min(ih,{LONG_SIDE})':{fit}");
    let range = stream.hdr.map_or(String::new(), Hdr::filters);
    let filter = format!("{}{select},{square},{most}{range}", stream.first);
    // Use our own numbers until all frames are present; `%` has a meaning to ffmpeg.
    let folder = wanted.into.join(".frames");
    match fs::remove_dir_all(&folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(VideoError::io(&folder)(error));
        }
        _ => fs::create_dir(&folder).map_err(VideoError::io(&folder))?,
    }
    let count = chosen.len().to_string();
    let arguments =
        ["-vf", &filter, "-frames:v", &count, "-f", "image2", "-c:v", "png", "%06d.png"];
    ffmpeg.run(&arguments.map(str::to_owned), Output::Folder(&folder))?;
    let mut files = Vec::with_capacity(chosen.len());
    for (at, number) in chosen.iter().enumerate() {
        let from = folder.join(format!("{:06}.png", at + 1));
        let to = wanted.into.join(format!("{}-{number:06}.png", wanted.stem));
        match fs::rename(&from, &to) {
            // A damaged video may lose frames on the second reading.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            moved => moved.map_err(VideoError::io(&to))?,
        }
        files.push(to);
    }
    fs::remove_dir_all(&folder).map_err(VideoError::io(&folder))?;
    Ok(files)
}

/// An expression that is true for the frames with these numbers. Balanced: ffmpeg parses no sum of
/// more than a hundred terms.
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
