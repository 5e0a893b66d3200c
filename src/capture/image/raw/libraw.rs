//! LibRaw's programs, for raw files that `flashraw` refuses: `raw-identify` tells a file's size and
//! white balance, `dcraw_emu` develops it to 16 bits of linear light.
//!
//! They are programs of their own, so a crash or a hostile file ends only them. They have the
//! limits of this process, end with it (where it has declared its guard), and have to be quick.
//! LibRaw cuts light at black: noise brightens what is darkest.

use std::ffi::OsStr;
use std::io::{self, Read};
use std::path::{Path, PathBuf, absolute};
use std::process::Stdio;
use std::sync::OnceLock;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::{Duration, Instant};

use image::metadata::Orientation;

use super::{CAMERA_LENGTH, MESSAGE_LENGTH, RawHeader, turned};
use crate::ffmpeg::{Words, is_not_started, last_line};
use crate::group::{self, Group};
use crate::image::decode::{ImageError, MAX_PIXELS};
use crate::image::resize::{AreaAverage, at_most};
use crate::image::{Image, Linear, Shot, exif};

/// Maximum times to tell about a file, and to develop it: less in total than a photograph has.
const TO_IDENTIFY: Duration = Duration::from_secs(20);
const TO_DEVELOP: Duration = Duration::from_secs(80);

/// Pause between two looks whether a program that has closed its output has ended.
const PAUSE: Duration = Duration::from_millis(5);

/// Bytes kept of what `raw-identify` says.
const WORDS: u64 = 1 << 20;

/// Where the programs are; bare names are looked up in `PATH`.
#[derive(Clone, Copy)]
pub(in crate::image) struct Programs {
    pub identify: &'static str,
    pub develop: &'static str,
}

pub(in crate::image) const INSTALLED: Programs =
    Programs { identify: "raw-identify", develop: "dcraw_emu" };

/// Why LibRaw does not read a file.
pub(in crate::image) enum Refusal {
    Missing,
    Other(String),
}

impl Refusal {
    /// The error for a file that `flashraw` refuses with `message`.
    pub(in crate::image) fn after(self, message: &str) -> ImageError {
        let message = match self {
            Self::Missing => format!(
                "{message}; LibRaw may read it, but its programs are not installed (apt-get install \
                 libraw-bin)"
            ),
            Self::Other(reason) => format!("{message}; LibRaw says: {reason}"),
        };
        ImageError::RawUnread { message }
    }
}

/// The installed version of LibRaw, such as `LibRaw 0.20.2`, if it is there.
pub fn version() -> Option<&'static str> {
    static VERSION: OnceLock<Option<String>> = OnceLock::new();
    let find = || {
        let usage = |program| run(program, &[], None, WORDS, TO_IDENTIFY / 4);
        let is_there = |program| !matches!(usage(program), Err(Refusal::Missing));
        if !(is_there(INSTALLED.identify) && is_there(INSTALLED.develop)) {
            return None;
        }
        // The one program of the package that tells its version, among its usage.
        let said = usage("simple_dcraw").unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        let number = said.split_once("LibRaw ").map_or("", |(_, rest)| rest);
        let number: String =
            number.chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
        Some(format!("LibRaw {number}").trim_end().to_owned())
    };
    VERSION.get_or_init(find).as_deref()
}

/// A raw file that LibRaw knows.
pub(in crate::image) struct Developed {
    programs: Programs,
    file: PathBuf,
    bytes: u64,
    /// Samples of the whole sensor.
    sensor: u64,
    /// Before it is turned.
    size: (usize, usize),
    orientation: Orientation,
    camera: String,
    /// Of red, green, blue and the mosaic's fourth colour; green is 1.
    white_balance: [f32; 4],
    pub(in crate::image) focal_px: Option<f64>,
    pub(in crate::image) shot: Option<Shot>,
}

impl Developed {
    /// # Errors
    /// Why LibRaw does not read it.
    pub(in crate::image) fn open(
        programs: Programs,
        file: &Path,
        bytes: u64,
    ) -> Result<Self, Refusal> {
        let words = run(programs.identify, &["-v".as_ref()], Some(file), WORDS, TO_IDENTIFY)?;
        let words = String::from_utf8_lossy(&words);
        let unknown = |what: &str| Refusal::Other(format!("it does not tell {what}"));
        // Texts of the file, which may hold such lines of their own, all come before.
        let report = words.rfind("\nFull size:").map(|at| &words[at..]);
        let report = report.ok_or_else(|| unknown("a size"))?;
        let size_of = |what| after(report, what).and_then(size).ok_or_else(|| unknown("a size"));
        let (full, size) = (size_of("Full size:")?, size_of("Output size:")?);
        for (width, height) in [full, size] {
            if (width * height) as u64 > MAX_PIXELS {
                return Err(Refusal::Other(format!("{width} x {height} px are too many")));
            }
        }
        // LibRaw's codes of the turns and mirrors that EXIF notes.
        let exif = match after(report, "Image flip:") {
            Some("1") => 2,
            Some("2") => 4,
            Some("3") => 3,
            Some("4") => 5,
            Some("5") => 8,
            Some("6") => 6,
            Some("7") => 7,
            _ => 1,
        };
        let orientation = Orientation::from_exif(exif).unwrap_or(Orientation::NoTransforms);
        let size = if orientation.to_exif() >= 5 { (size.1, size.0) } else { size };
        let noted = after(report, "As shot").or_else(|| after(report, "Derived D65 multipliers:"));
        let camera = after(&words, "Camera:")
            .map_or("", |line| line.split_once(" ID:").map_or(line, |(camera, _)| camera));
        Ok(Self {
            programs,
            file: file.to_owned(),
            bytes,
            sensor: (full.0 * full.1) as u64,
            size,
            orientation,
            camera: camera.trim().chars().take(CAMERA_LENGTH).collect(),
            white_balance: noted.and_then(multipliers).ok_or_else(|| unknown("a white balance"))?,
            focal_px: after(&words, "FocalLengthIn35mmFormat:")
                .and_then(|text| text.split(' ').next()?.parse().ok())
                .and_then(|equivalent: f64| exif::of_equivalent(equivalent, size.0, size.1)),
            shot: shot(&words),
        })
    }

    /// Width and height of the upright picture, px.
    pub(in crate::image) fn upright(&self) -> (usize, usize) {
        let (width, height) = self.size;
        if self.orientation.to_exif() >= 5 { (height, width) } else { (width, height) }
    }

    pub(in crate::image) fn orientation(&self) -> Orientation {
        self.orientation
    }

    pub(in crate::image) fn header(&self) -> RawHeader {
        let [red, green, blue, _] = self.white_balance;
        let reader = version().unwrap_or("LibRaw").to_owned();
        let white_balance = [red, green, blue];
        RawHeader { camera: self.camera.clone(), white_balance, reader: Some(reader) }
    }

    /// Bytes that reading needs: LibRaw's samples and four channels, and its picture twice.
    pub(in crate::image) fn decoded_bytes(&self) -> u64 {
        let pixels = (self.size.0 * self.size.1) as u64;
        let developed = pixels.saturating_mul(8 + 12);
        self.bytes.saturating_add(2 * self.sensor).saturating_add(developed)
    }

    /// As [`super::Raw::light`].
    ///
    /// # Errors
    /// [`ImageError::RawUnread`].
    pub(in crate::image) fn light(
        &self,
        long_side: usize,
        white_balance: Option<[f32; 3]>,
    ) -> Result<Image<Linear>, ImageError> {
        let (width, height) = self.size;
        let (out_width, out_height) = at_most(width, height, long_side.max(1));
        // Means of the mosaic's cells in place of colours that are guessed between them.
        let is_half = 2 * out_width.max(out_height) <= width.max(height);
        let [red, green, blue, fourth] = self.white_balance;
        let balance = match white_balance {
            Some([red, green, blue]) => [red, green, blue, fourth * green],
            None => [red, green, blue, fourth],
        };
        let balance = balance.map(|v| format!("{v:.6}"));
        // To standard output (-Z -), 16 bits of linear light without brightening (-4) of sRGB's
        // primaries (-o 1), white where a channel clips (-H 0) at the camera's white level (-c 0),
        // bilinear (-q 0), not turned (-t 0), with this white balance (-r).
        let words = "-Z - -4 -o 1 -H 0 -c 0 -q 0 -t 0".split(' ');
        let mut arguments: Vec<&OsStr> = words.map(OsStr::new).collect();
        if is_half {
            arguments.push("-h".as_ref());
        }
        arguments.push("-r".as_ref());
        arguments.extend(balance.iter().map(OsStr::new));
        let most = 64 + 6 * ((width + 2) * (height + 2)) as u64;
        let unread = |message| ImageError::RawUnread { message };
        let bytes = run(self.programs.develop, &arguments, Some(&self.file), most, TO_DEVELOP)
            .map_err(|refusal| refusal.after("LibRaw knows its header alone"))?;
        let picture = Picture::read(&bytes).ok_or_else(|| {
            unread("LibRaw's picture is incomplete, perhaps for lack of memory".to_owned())
        })?;
        // A file without a mosaic is not halved.
        let is_like = |scale: usize| {
            let off = |found: usize, wanted: usize| (scale * found).abs_diff(wanted);
            off(picture.width, width).max(off(picture.height, height)) <= 2
        };
        if !(is_like(1) || is_half && is_like(2)) {
            let (w, h) = (picture.width, picture.height);
            return Err(unread(format!(
                "LibRaw's picture has {w} x {h} px for {width} x {height}"
            )));
        }
        let (out_width, out_height) =
            (out_width.min(picture.width), out_height.min(picture.height));
        let mut image = Image::new(out_width, out_height);
        let average = AreaAverage::new((picture.width, picture.height), (out_width, out_height));
        for channel in 0..3 {
            let row = |y: usize, out: &mut [f32]| picture.row(channel, y, out);
            average.plane(picture.width, row, image.plane_mut(channel));
        }
        Ok(turned(image, self.orientation))
    }
}

/// A PPM or PGM of 16 bits.
struct Picture<'a> {
    width: usize,
    height: usize,
    channels: usize,
    samples: &'a [u8],
}

impl<'a> Picture<'a> {
    fn read(bytes: &'a [u8]) -> Option<Self> {
        // Each word ends with one white byte; LibRaw writes no comments.
        let mut rest = bytes;
        let mut word = || {
            let end = rest.iter().position(u8::is_ascii_whitespace)?;
            let word = std::str::from_utf8(&rest[..end]).ok()?;
            rest = &rest[end + 1..];
            Some(word)
        };
        let channels = match word()? {
            "P6" => 3,
            "P5" => 1,
            _ => return None,
        };
        let (width, height) = (word()?.parse().ok()?, word()?.parse().ok()?);
        let is_deep = word()? == "65535";
        let length = 2_usize.checked_mul(channels)?.checked_mul(width)?.checked_mul(height)?;
        let is_whole = is_deep && length > 0 && rest.len() == length;
        is_whole.then_some(Self { width, height, channels, samples: rest })
    }

    /// A row of light.
    fn row(&self, channel: usize, y: usize, out: &mut [f32]) {
        let stride = 2 * self.channels;
        let row = &self.samples[y * self.width * stride..][..self.width * stride];
        let at = 2 * (channel % self.channels);
        for (value, pixel) in out.iter_mut().zip(row.chunks_exact(stride)) {
            *value = f32::from(u16::from_be_bytes([pixel[at], pixel[at + 1]])) / 65_535.0;
        }
    }
}

/// The rest of the first line that begins so.
fn after<'a>(words: &'a str, begin: &str) -> Option<&'a str> {
    words.lines().find_map(|line| line.trim_start().strip_prefix(begin)).map(str::trim)
}

/// The exposure, if it is stated.
fn shot(words: &str) -> Option<Shot> {
    let number = |text: &str| {
        let value: f64 = text.split_whitespace().next()?.parse().ok()?;
        (value.is_finite() && value > 0.0).then_some(value)
    };
    let shutter = after(words, "Shutter:")?;
    let seconds = match shutter.strip_prefix("1/") {
        Some(parts) => number(parts)?.recip(),
        None => number(shutter)?,
    };
    Some(Shot {
        seconds,
        iso: number(after(words, "ISO speed:")?)?,
        f_number: after(words, "Aperture: f/").and_then(number),
    })
}

/// Of "1680 x 1119".
fn size(text: &str) -> Option<(usize, usize)> {
    let (width, height) = text.split_once('x')?;
    let side = |text: &str| text.trim().parse().ok().filter(|side| (1..65_536).contains(side));
    Some((side(width)?, side(height)?))
}

/// Of "2 1 1.42857 0"; the fourth is green's if it is missing or 0.
fn multipliers(text: &str) -> Option<[f32; 4]> {
    let all: Vec<f32> = text.split_whitespace().map_while(|word| word.parse().ok()).collect();
    let [red, green, blue, ref rest @ ..] = all[..] else { return None };
    let fourth = rest.first().copied().filter(|v| *v > 0.0).unwrap_or(green);
    let balance = [red / green, 1.0, blue / green, fourth / green];
    balance.iter().all(|v| v.is_finite() && (1e-3..1e3).contains(v)).then_some(balance)
}

/// Runs a program and returns its standard output, cut after `most` bytes.
fn run(
    program: &str,
    arguments: &[&OsStr],
    file: Option<&Path>,
    most: u64,
    patience: Duration,
) -> Result<Vec<u8>, Refusal> {
    let until = Instant::now() + patience;
    let late = || Refusal::Other(format!("{program} took more than {} s", patience.as_secs()));
    let failed = |error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => Refusal::Missing,
        _ => Refusal::Other(error.to_string()),
    };
    let mut command = group::ending_with_this(Path::new(program)).map_err(failed)?;
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    // Others decode meanwhile, and its threads would each have memory of their own.
    command.env("OMP_NUM_THREADS", "1");
    if let Some(file) = file {
        // A name that begins with a hyphen is no option.
        command.arg(absolute(file).map_err(failed)?);
    }
    let mut child = Group::spawn(&mut command).map_err(failed)?;
    let (stdout, stderr) = child.outputs();
    let words = Words::of(stderr);
    let (sender, written) = sync_channel(1);
    thread::spawn(move || {
        let mut bytes = Vec::new();
        let read = stdout.expect("piped").take(most).read_to_end(&mut bytes);
        // The receiver has gone if it took too long.
        let _ = sender.send(read.map(|_| bytes));
    });
    let Ok(bytes) = written.recv_timeout(patience) else {
        child.kill();
        return Err(late());
    };
    let bytes = bytes.map_err(failed)?;
    // It may be blocked writing what exceeds the limit.
    let is_all = (bytes.len() as u64) < most;
    let mut status = None;
    while is_all && status.is_none() {
        if Instant::now() > until {
            child.kill();
            return Err(late());
        }
        status = child.try_wait().map_err(failed)?;
        if status.is_none() {
            thread::sleep(PAUSE);
        }
    }
    let status = status.and_then(|status| status.code());
    if status.is_some_and(is_not_started) {
        return Err(Refusal::Missing);
    }
    // The programs end with 0 whatever happens, but write nothing if they fail.
    if bytes.is_empty() {
        let text = words.all(file.unwrap_or(Path::new("/")));
        let reason = last_line(&text).chars().take(MESSAGE_LENGTH).collect();
        return Err(Refusal::Other(reason));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests;
