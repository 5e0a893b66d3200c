//! A video as photographs: of every stretch the sharpest frame.
//!
//! ffmpeg reads it in a process of its own: first its beginning, to see how its frames are coded,
//! then all of it small and grey, to measure sharpness, and last the chosen frames.

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

use self::choose::{Stretches, sharpness};
use self::error::{MOST_IN_VIDEO, PATIENCE};
use self::ffmpeg::{Ffmpeg, Output};
use self::stream::Stream;
use crate::cancel::CancelToken;
use crate::image::{Unread, read_header};

pub use self::error::VideoError;
pub use self::range::Hdr;

/// Frames that are taken when nobody says how many.
pub const FRAMES: usize = 40;

/// Most frames that are taken.
pub const MOST_FRAMES: usize = 500;

/// Frames of a larger video are brought down to this long side, px, by area: no preset trains on
/// more, and noise is averaged.
const LONG_SIDE: usize = 1920;

/// Side of the square in which sharpness is measured, px. What is compared has one shape anyway.
const MEASURED_SIDE: usize = 320;

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
    /// The treatment of a range of brightness larger than that of sRGB.
    pub hdr: Option<Hdr>,
    /// Whether each frame was made of two fields of different moments.
    pub is_interlaced: bool,
}

impl Taken {
    /// A sentence for who gave the video, which they call `name`.
    pub fn told(&self, name: &str) -> String {
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

/// Whether a file's name says that it is a video that is read.
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().and_then(|extension| extension.to_str());
    let known = ["mp4", "mov", "m4v"];
    extension.is_some_and(|extension| known.iter().any(|one| one.eq_ignore_ascii_case(extension)))
}

/// Writes the sharpest frames of `video` as PNG files. `command` is ffmpeg, or what starts it with
/// the arguments that follow; one that ends with 127 has not found it, as with shells.
///
/// # Errors
/// [`VideoError`]; what was written by then stays.
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
    if sharpness.len() < super::MIN_VIEWS {
        return Err(VideoError::TooShort { frames: sharpness.len() });
    }
    let chosen = Stretches::of(sharpness.len(), wanted.count).sharpest(&sharpness);
    fs::create_dir_all(wanted.into).map_err(VideoError::io(wanted.into))?;
    // One says how large they all may be, and whether this ffmpeg converts their range.
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

/// How sharp each frame is.
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

/// Writes the frames of these numbers, in order.
fn extract(
    ffmpeg: &Ffmpeg<'_>,
    chosen: &[usize],
    wanted: &Wanted<'_>,
    stream: &Stream,
) -> Result<Vec<PathBuf>, VideoError> {
    let select = format!("select='{}'", any_of(chosen));
    // Pixels that are not square, then those that are too many.
    let square = "scale='trunc(iw*sar)':ih:flags=area,setsar=1";
    let fit = "force_original_aspect_ratio=decrease:flags=area";
    let most = format!("scale='min(iw,{LONG_SIDE})':'min(ih,{LONG_SIDE})':{fit}");
    let range = stream.hdr.map_or(String::new(), Hdr::filters);
    let filter = format!("{}{select},{square},{most}{range}", stream.first);
    // Numbers of ours until they are known to be all there; `%` means something to ffmpeg.
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
