//! Reading: any photograph to upright planar RGB, never larger than the header declares.
//!
//! Conversion of each input: grey is repeated in all three channels; palettes are looked up; alpha
//! is composited over black, in the encoded values; 16 bits stay 16 bits deep (`v / 65535`); colour
//! profiles are applied ([`super::colour`]), and CMYK without one is mixed as if inks were filters;
//! a PQ or HLG HEIC is converted to sRGB ([`super::hdr`]); raw files have light of their own
//! ([`super::raw`]); EXIF orientation is applied once, here and nowhere else, or a HEIC's own
//! instead. Floating-point TIFF is refused, as its range and encoding are unknown.

mod error;
mod heic;
mod inks;
mod jpeg;
mod pages;
mod profile;
pub(crate) mod shares;

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use half::f16;
use image::metadata::Orientation;
use image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageFormat, ImageReader, Limits};

use self::heic::Heic;
use self::profile::Declared;
use super::colour::{Channels, Colour};
use super::hdr::HdrTransfer;
use super::raw::libraw::{self, Developed};
use super::raw::{self, Raw, RawHeader};
use super::resize::{AreaAverage, at_most};
use super::signature::{Kind, kind};
use super::{Image, Linear, Shot, Srgb, exif};

pub use self::error::{ImageError, MAX_FILE_BYTES, MAX_PIXELS};

/// Maximum allocation of a decoder, bytes: 16-bit RGBA of [`MAX_PIXELS`] fits.
const MAX_DECODE_BYTES: u64 = 1 << 30;

/// A file's header, read without decoding.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Width of the upright picture, px.
    pub width: usize,
    /// Height of the upright picture, px.
    pub height: usize,
    /// The EXIF orientation, which is applied here to the stored pixels. None for a HEIC, which
    /// every reader rotates as its container specifies.
    pub orientation: Orientation,
    /// Focal length in px of the stored picture, from EXIF.
    pub focal_px: Option<f64>,
    /// The exposure, from EXIF.
    pub shot: Option<Shot>,
    /// Bytes needed for the decoded samples while reading.
    pub decoded_bytes: u64,
    /// The larger brightness range that is converted to sRGB while reading.
    pub hdr: Option<HdrTransfer>,
    /// Whether the pixels have alpha.
    pub has_alpha: bool,
    /// The name of the colour profile that is applied while reading, unless the values are sRGB.
    pub profile: Option<String>,
    /// Why a colour profile cannot be applied; the values are taken as sRGB.
    pub profile_fault: Option<String>,
    /// Only of a raw file.
    pub raw: Option<RawHeader>,
}

impl Header {
    /// The colour profile that is applied, or the camera of a raw file; `None` for sRGB.
    pub fn colours(&self) -> Option<String> {
        let of_raw = self.raw.as_ref().map(|raw| match &raw.reader {
            Some(reader) => format!("raw, {}, read by {reader}", raw.camera),
            None => format!("raw, {}", raw.camera),
        });
        of_raw.or_else(|| self.profile.clone())
    }
}

/// Reads a file's header and checks it against [`MAX_PIXELS`] and [`MAX_FILE_BYTES`].
///
/// # Errors
/// [`ImageError`]; a valid header does not guarantee that the picture is intact.
pub fn read_header(path: &Path) -> Result<Header, ImageError> {
    guarded(|| Ok(Source::open(path)?.into_header()))
}

impl Image<Srgb> {
    /// Reads a photograph at its own size.
    ///
    /// # Errors
    /// [`ImageError`]; nothing is decoded if the header exceeds the limits.
    pub fn load(path: &Path) -> Result<Self, ImageError> {
        let samples = match Decoded::of(path, usize::MAX, None)? {
            Decoded::Samples(samples) if samples.colour.is_srgb() => samples,
            decoded => return Ok(decoded.light(usize::MAX).to_srgb()),
        };
        let table = samples.table(|v| v);
        let mut image = Self::new(samples.width, samples.height);
        let width = samples.width;
        for channel in 0..3 {
            for (y, row) in image.plane_mut(channel).chunks_exact_mut(width).enumerate() {
                samples.row(channel, y, &table, row);
            }
        }
        Ok(image)
    }

    /// Reads a photograph with its long side reduced to at most `long_side` px, by area average in
    /// linear light, as a sensor with larger pixels would have recorded it. Never enlarges. The
    /// full-size picture never exists as floats.
    ///
    /// # Errors
    /// As [`Image::load`].
    pub fn load_at_most(path: &Path, long_side: usize) -> Result<Self, ImageError> {
        Ok(Image::load_light(path, long_side)?.to_srgb())
    }
}

impl Image<Linear> {
    /// As [`Image::load_at_most`], in linear light.
    ///
    /// # Errors
    /// As [`Image::load`].
    pub fn load_light(path: &Path, long_side: usize) -> Result<Self, ImageError> {
        Self::load_balanced(path, long_side, None)
    }

    /// As [`Image::load_light`]; raw files are balanced to these multipliers of red, green and blue
    /// in place of their own.
    ///
    /// # Errors
    /// As [`Image::load`].
    pub fn load_balanced(
        path: &Path,
        long_side: usize,
        white_balance: Option<[f32; 3]>,
    ) -> Result<Self, ImageError> {
        Ok(Decoded::of(path, long_side, white_balance)?.light(long_side))
    }
}

/// A decoded file.
enum Decoded {
    Samples(Samples),
    /// A raw file's light at the size that was asked for.
    Light(Image<Linear>),
}

impl Decoded {
    fn of(
        path: &Path,
        long_side: usize,
        white_balance: Option<[f32; 3]>,
    ) -> Result<Self, ImageError> {
        #[cfg(test)]
        DECODED.lock().expect("unpoisoned").push(path.to_owned());
        guarded(|| match Source::open(path)? {
            Source::Picture(opened) => Ok(Self::Samples(Samples::decode(*opened, path)?)),
            Source::Raw(raw) => Ok(Self::Light(raw.light(long_side, white_balance)?)),
            Source::Developed(raw) => Ok(Self::Light(raw.light(long_side, white_balance)?)),
        })
    }

    fn light(self, long_side: usize) -> Image<Linear> {
        match self {
            Self::Samples(samples) => samples.light(long_side),
            Self::Light(image) => image,
        }
    }
}

/// A file whose header has been read and accepted: a picture, or a raw file.
enum Source {
    Picture(Box<Opened>),
    Raw(Box<Raw>),
    /// A raw file that LibRaw develops.
    Developed(Box<Developed>),
}

impl Source {
    fn open(path: &Path) -> Result<Self, ImageError> {
        let io = |source| ImageError::Io { path: path.to_owned(), source };
        let (mut file, length) = regular(path)?;
        let mut head = Vec::with_capacity(32);
        Read::by_ref(&mut file).take(32).read_to_end(&mut head).map_err(io)?;
        file.rewind().map_err(io)?;
        match kind(&head, path) {
            Kind::Readable(format) => Opened::picture(path, file, format, length),
            Kind::Heic if length > heic::LONGEST => {
                Err(ImageError::Unsupported { message: "a HEIC of more than 128 MiB".to_owned() })
            }
            Kind::Heic => Opened::heic(whole(file).map_err(io)?),
            Kind::Raw if length > raw::LONGEST => Err(ImageError::Unsupported {
                message: "a raw file of more than 256 MiB".to_owned(),
            }),
            Kind::Raw => return Self::raw(path, whole(file).map_err(io)?, libraw::INSTALLED),
            Kind::Video => Err(ImageError::Video),
            Kind::Unread(format) => Err(ImageError::Unread(format)),
            Kind::Unknown => Err(ImageError::UnknownFormat),
        }
        .map(|opened| Self::Picture(Box::new(opened)))
    }

    /// What `flashraw` refuses is for LibRaw.
    fn raw(path: &Path, bytes: Vec<u8>, programs: libraw::Programs) -> Result<Self, ImageError> {
        let length = bytes.len() as u64;
        let exif = raw::own_exif(&bytes);
        let message = match Raw::open(bytes) {
            Err(ImageError::RawUnread { message }) => message,
            outcome => return outcome.map(|raw| Self::Raw(Box::new(raw))),
        };
        let developed = Developed::open(programs, path, length);
        let mut developed = developed.map_err(|refusal| refusal.after(&message))?;
        // Its own tags know more than LibRaw's program tells.
        let (width, height) = developed.upright();
        let focal_px = exif.as_ref().and_then(|exif| exif::focal_px(exif, width, height));
        developed.focal_px = focal_px.or(developed.focal_px);
        developed.shot = exif.as_ref().and_then(exif::shot).or(developed.shot);
        Ok(Self::Developed(Box::new(developed)))
    }

    fn into_header(self) -> Header {
        let ((width, height), orientation, decoded_bytes, focal_px, shot, raw) = match self {
            Self::Picture(opened) => return opened.header,
            Self::Raw(raw) => (
                raw.size(),
                raw.orientation(),
                raw.decoded_bytes(),
                raw.focal_px(),
                raw.shot(),
                raw.header(),
            ),
            Self::Developed(raw) => (
                raw.upright(),
                raw.orientation(),
                raw.decoded_bytes(),
                raw.focal_px,
                raw.shot,
                raw.header(),
            ),
        };
        Header {
            width,
            height,
            orientation,
            focal_px,
            shot,
            decoded_bytes,
            hdr: None,
            has_alpha: false,
            profile: None,
            profile_fault: None,
            raw: Some(raw),
        }
    }
}

/// A file and its length, if it is of an acceptable one.
fn regular(path: &Path) -> Result<(BufReader<File>, u64), ImageError> {
    let io = |source| ImageError::Io { path: path.to_owned(), source };
    let file = File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    if !metadata.is_file() {
        return Err(ImageError::UnknownFormat);
    }
    match metadata.len() {
        0 => Err(ImageError::Empty),
        bytes if bytes > MAX_FILE_BYTES => Err(ImageError::TooManyBytes { bytes }),
        length => Ok((BufReader::new(file), length)),
    }
}

fn whole(mut file: BufReader<File>) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// A file whose header has been read and accepted.
struct Opened {
    decoder: Box<dyn ImageDecoder>,
    orientation: Orientation,
    header: Header,
    colour: Colour,
    /// None for a HEIC.
    format: Option<ImageFormat>,
}

impl Opened {
    /// Opens a mask, or a photograph for its alpha; raw files serve as neither.
    fn open(path: &Path) -> Result<Self, ImageError> {
        match Source::open(path)? {
            Source::Picture(opened) => Ok(*opened),
            Source::Raw(_) | Source::Developed(_) => {
                Err(ImageError::Unsupported { message: "a raw file in place of a mask".to_owned() })
            }
        }
    }

    fn heic(bytes: Vec<u8>) -> Result<Self, ImageError> {
        let heic = Heic::open(bytes)?;
        let (beside, hdr) = (heic.bytes_beside(), heic.hdr());
        let srgb = hdr.map(|_| Colour::srgb());
        let declared = srgb.or_else(|| heic.colour()).map(Declared::Colour);
        let mut opened = Self::with_decoder(Box::new(heic), None, beside, declared, false)?;
        opened.header.hdr = hdr;
        Ok(opened)
    }

    fn picture(
        path: &Path,
        mut file: BufReader<File>,
        format: ImageFormat,
        length: u64,
    ) -> Result<Self, ImageError> {
        let io = |source| ImageError::Io { path: path.to_owned(), source };
        match format {
            ImageFormat::Tiff => {
                let mut file = pages::Paged::open(file.into_inner()).map_err(io)?;
                let declared = profile::of_tiff(&mut file).map(Declared::Icc);
                file.rewind().map_err(io)?;
                Self::with_reader(file, format, 0, declared, false)
            }
            // The decoder and the check each hold the whole file.
            ImageFormat::Jpeg => {
                let has_inks = inks::are_in_jpeg(&mut file);
                file.rewind().map_err(io)?;
                Self::with_reader(file, format, 2 * length, None, has_inks).map_err(|error| {
                    // The decoder does not name most unsupported kinds.
                    match jpeg::check(&fs::read(path).unwrap_or_default()) {
                        Err(kind @ ImageError::Unsupported { .. }) => kind,
                        _ => error,
                    }
                })
            }
            ImageFormat::Png => {
                let declared = profile::of_png(&mut file);
                file.rewind().map_err(io)?;
                Self::with_reader(file, format, 0, declared, false)
            }
            _ => Self::with_reader(file, format, 0, None, false),
        }
    }

    fn with_reader(
        file: impl BufRead + Seek + 'static,
        format: ImageFormat,
        beside: u64,
        declared: Option<Declared>,
        has_inks: bool,
    ) -> Result<Self, ImageError> {
        let mut reader = ImageReader::with_format(file, format);
        let mut limits = Limits::default();
        limits.max_alloc = Some(MAX_DECODE_BYTES);
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(|error| image_error(&error))?;
        Self::with_decoder(Box::new(decoder), Some(format), beside, declared, has_inks)
    }

    /// `format`: none for HEIC. `beside`: bytes that decoding needs besides the samples.
    /// `declared`: colours that the decoder does not know of. `has_inks`: a JPEG's, which its
    /// decoder does not report.
    fn with_decoder(
        mut decoder: Box<dyn ImageDecoder>,
        format: Option<ImageFormat>,
        beside: u64,
        declared: Option<Declared>,
        has_inks: bool,
    ) -> Result<Self, ImageError> {
        let (width, height) = decoder.dimensions();
        if u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(ImageError::TooManyPixels { width, height });
        }
        let is_sphere = u64::from(width).abs_diff(2 * u64::from(height)) * 100 <= u64::from(width);
        if is_sphere {
            let xmp = decoder.xmp_metadata().ok().flatten().unwrap_or_default();
            if String::from_utf8_lossy(&xmp).contains("equirectangular") {
                return Err(ImageError::Panorama);
            }
        }
        let exif = decoder.exif_metadata().ok().flatten().and_then(exif::read);
        // A HEIC's own takes precedence, and a TIFF has it in its own tags.
        let orientation = match &exif {
            Some(exif) if format.is_some() => exif::orientation(exif),
            _ => decoder.orientation().ok(),
        };
        let orientation = orientation.unwrap_or(Orientation::NoTransforms);
        // A rotated picture is a second copy.
        let copies = if orientation == Orientation::NoTransforms { 1 } else { 2 };
        let has_alpha = decoder.color_type().has_alpha();
        let channels = channels(decoder.as_ref(), has_inks);
        let of_jpeg = exif.as_ref().filter(|_| format == Some(ImageFormat::Jpeg));
        let (colour, profile_fault) = profile::of(decoder.as_mut(), channels, declared, of_jpeg);
        // Tables, and those of inks, convert into a copy of 16 bits.
        let has_copy = colour.has_tables() || colour.inks().is_some();
        let copies = if has_copy { copies + 4 } else { copies };
        let decoded_bytes = decoder.total_bytes().saturating_mul(copies);
        let decoded_bytes = decoded_bytes.saturating_add(beside);
        let (width, height) = match orientation.to_exif() {
            5..=8 => (height as usize, width as usize),
            _ => (width as usize, height as usize),
        };
        let focal_px = exif.as_ref().and_then(|exif| exif::focal_px(exif, width, height));
        let shot = exif.as_ref().and_then(exif::shot);
        Ok(Self {
            decoder,
            orientation,
            header: Header {
                width,
                height,
                orientation,
                focal_px,
                shot,
                decoded_bytes,
                hdr: None,
                has_alpha,
                profile: colour.name().map(str::to_owned),
                profile_fault,
                raw: None,
            },
            colour,
            format,
        })
    }
}

fn channels(decoder: &dyn ImageDecoder, has_inks: bool) -> Channels {
    let cmyk = [ExtendedColorType::Cmyk8, ExtendedColorType::Cmyk16];
    match has_inks || cmyk.contains(&decoder.original_color_type()) {
        true => Channels::Cmyk,
        false if decoder.color_type().has_color() => Channels::Rgb,
        false => Channels::Grey,
    }
}

/// Upright interleaved samples, one channel (grey) or three, without alpha.
struct Samples {
    width: usize,
    height: usize,
    channels: usize,
    values: Values,
    colour: Colour,
}

/// Samples at the file's bit depth.
enum Values {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
    /// Bits of half floats.
    Halves(Vec<u16>),
}

impl Values {
    /// With 16 bits.
    fn deep(self) -> Vec<u16> {
        match self {
            Self::Eight(values) => values.into_iter().map(|v| 257 * u16::from(v)).collect(),
            Self::Sixteen(values) | Self::Halves(values) => values,
        }
    }
}

impl Samples {
    fn decode(opened: Opened, path: &Path) -> Result<Self, ImageError> {
        let bytes = match opened.format {
            Some(ImageFormat::Jpeg) => {
                fs::read(path).map_err(|source| ImageError::Io { path: path.to_owned(), source })?
            }
            _ => Vec::new(),
        };
        if opened.format == Some(ImageFormat::Jpeg) {
            jpeg::check(&bytes)?;
        }
        let (width, height) = (opened.header.width, opened.header.height);
        let colour = opened.colour;
        if let Some(inks) = colour.inks() {
            let mut picture = match opened.format {
                Some(ImageFormat::Jpeg) => inks::of_jpeg(&bytes)?,
                _ => inks::of_tiff(path)?,
            };
            picture.apply_orientation(opened.orientation);
            let values = Values::Halves(match picture {
                DynamicImage::ImageRgba8(buffer) => inks.halves(&buffer, 255.0),
                deep => inks.halves(&deep.into_rgba16(), 65_535.0),
            });
            return Ok(Self { width, height, channels: 3, values, colour: Colour::light_itself() });
        }
        let mut picture =
            DynamicImage::from_decoder(opened.decoder).map_err(|error| image_error(&error))?;
        picture.apply_orientation(opened.orientation);
        let (channels, values) = interleaved(picture)?;
        if !colour.has_tables() {
            return Ok(Self { width, height, channels, values, colour });
        }
        let converted = colour.table_converted(&values.deep());
        let damaged = |reason| ImageError::Damaged { message: format!("its profile: {reason}") };
        let (values, colour) = (Values::Sixteen(converted.map_err(damaged)?), Colour::srgb());
        Ok(Self { width, height, channels, values, colour })
    }

    /// With the long side reduced to at most `long_side` px, in linear light.
    fn light(&self, long_side: usize) -> Image<Linear> {
        let from = (self.width, self.height);
        let (width, height) = at_most(from.0, from.1, long_side.max(1));
        let average = AreaAverage::new(from, (width, height));
        let mut image = Image::new(width, height);
        for channel in 0..3 {
            let table = self.table(|v| self.colour.light(channel, v));
            let row = |y: usize, buffer: &mut [f32]| self.row(channel, y, &table, buffer);
            average.plane(from.0, row, image.plane_mut(channel));
        }
        // Averages of light may be mixed as well as the light itself.
        self.colour.bring_to_srgb(&mut image);
        image
    }

    /// The meaning of every sample value, after `f`.
    fn table(&self, f: impl Fn(f32) -> f32) -> Vec<f32> {
        let top = match self.values {
            Values::Eight(_) => 255_u32,
            Values::Sixteen(_) => 65_535,
            Values::Halves(_) => {
                return (0..=u16::MAX).map(|bits| f(f16::from_bits(bits).to_f32())).collect();
            }
        };
        (0..=top).map(|v| f(v as f32 / top as f32)).collect()
    }

    /// One row of one channel, looked up in a table of [`Samples::table`].
    fn row(&self, channel: usize, y: usize, table: &[f32], out: &mut [f32]) {
        let stride = self.width * self.channels;
        let (range, offset) = (y * stride..(y + 1) * stride, channel % self.channels);
        match &self.values {
            Values::Eight(values) => look_up(&values[range], offset, self.channels, table, out),
            Values::Sixteen(values) | Values::Halves(values) => {
                look_up(&values[range], offset, self.channels, table, out);
            }
        }
    }
}

fn look_up<T: Copy + Into<usize>>(
    row: &[T],
    offset: usize,
    stride: usize,
    table: &[f32],
    out: &mut [f32],
) {
    out.iter_mut()
        .zip(row[offset..].iter().step_by(stride))
        .for_each(|(v, &sample)| *v = table[sample.into()]);
}

/// Channels (1 or 3) and samples of a decoded picture; alpha is composited over black.
fn interleaved(picture: DynamicImage) -> Result<(usize, Values), ImageError> {
    use DynamicImage as D;
    use Values::{Eight, Sixteen};
    Ok(match picture {
        D::ImageLuma8(buffer) => (1, Eight(buffer.into_raw())),
        D::ImageRgb8(buffer) => (3, Eight(buffer.into_raw())),
        D::ImageLuma16(buffer) => (1, Sixteen(buffer.into_raw())),
        D::ImageRgb16(buffer) => (3, Sixteen(buffer.into_raw())),
        D::ImageLumaA8(buffer) => (1, Eight(over_black(buffer.into_raw(), 2))),
        D::ImageRgba8(buffer) => (3, Eight(over_black(buffer.into_raw(), 4))),
        D::ImageLumaA16(buffer) => (1, Sixteen(over_black(buffer.into_raw(), 2))),
        D::ImageRgba16(buffer) => (3, Sixteen(over_black(buffer.into_raw(), 4))),
        other => {
            let message = format!("samples of type {:?}", other.color());
            return Err(ImageError::Unsupported { message });
        }
    })
}

/// The colour of straight-alpha pixels over black, rounded to the samples' own steps; in place, as
/// there is no memory for a second copy of a large picture's samples.
fn over_black<T: image::Primitive>(mut samples: Vec<T>, stride: usize) -> Vec<T> {
    let top = T::DEFAULT_MAX_VALUE.to_u64().expect("an integer sample");
    let composited = |value: T, alpha: u64| {
        let product = value.to_u64().expect("an integer sample") * alpha;
        T::from((product + top / 2) / top).expect("not above the sample it came from")
    };
    let pixels = samples.len() / stride;
    for pixel in 0..pixels {
        let alpha = samples[pixel * stride + stride - 1];
        let alpha = alpha.to_u64().expect("an integer sample");
        for channel in 0..stride - 1 {
            // Never ahead of the read position.
            samples[pixel * (stride - 1) + channel] =
                composited(samples[pixel * stride + channel], alpha);
        }
    }
    samples.truncate(pixels * (stride - 1));
    samples
}

/// Converts a decoder's error to ours.
fn image_error(error: &image::ImageError) -> ImageError {
    let message = format!("its decoder says: {error}");
    match error {
        image::ImageError::Unsupported(_) => ImageError::Unsupported { message },
        image::ImageError::Limits(_) => {
            ImageError::Unsupported { message: "decoding it takes more than 1 GiB".to_owned() }
        }
        _ => ImageError::Damaged { message },
    }
}

/// Runs a decoder; a panic caused by a hostile file is an error of the file, not of the run.
pub(super) fn guarded<T>(decode: impl FnOnce() -> Result<T, ImageError>) -> Result<T, ImageError> {
    catch_unwind(AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(ImageError::Damaged { message: "the decoder gave up".to_owned() }))
}

/// The files that were decoded.
#[cfg(test)]
pub(crate) static DECODED: std::sync::Mutex<Vec<std::path::PathBuf>> =
    std::sync::Mutex::new(Vec::new());

#[cfg(test)]
mod tests;
