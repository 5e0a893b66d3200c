//! Camera raw files: from the sensor's samples to linear light of sRGB primaries.
//!
//! `flashraw` unpacks the samples and knows the cameras. The light is computed here, because its
//! own conversions clip at black: noise scatters to both sides of black, and a mean over pixels or
//! photographs is right only with both. In order: black and white level; the second opcode
//! list of DNG (lens shading); white balance; highlights that a channel clips are neutral; area
//! average of each colour of the mosaic; the camera's matrix. Brightening hints (BaselineExposure,
//! tone curves, ProfileGainTableMap) are not applied: they differ from photograph to photograph.

#[cfg(test)]
pub(crate) mod dng;
pub(super) mod libraw;
mod mosaic;

use flashraw::low_level::codecs::dng_opcodes::{self, PlaneImage};
use flashraw::{
    CfaColor, CorruptionPolicy, DecodeOptions, Error, FlashRaw, FrameInfo, Limits, OutputFormat,
    RawFrame, RawPixelData, SensorLayout,
};
use glam::{DMat3, DVec3};
use image::metadata::Orientation;

use self::mosaic::Mosaic;
use super::colour::mixed;
use super::decode::{ImageError, MAX_PIXELS};
use super::resize::at_most;
use super::{Image, Linear, Shot, exif};

/// Maximum file size, bytes: it is read whole, several times. 100 megapixels of 16 bits take
/// 200 MiB.
pub(super) const LONGEST: u64 = 256 << 20;

/// Characters of a camera's name, and of a decoder's message, that are kept of a file's text.
const CAMERA_LENGTH: usize = 60;
const MESSAGE_LENGTH: usize = 200;

/// Largest element of a camera's plausible matrix.
const LARGEST_ELEMENT: f64 = 16.0;

/// Opcodes of DNG's second list that are applied; cameras write a map for each colour.
const MAX_OPCODES: usize = 64;

/// In place of a sensitivity that does not fit EXIF's tag.
const UNKNOWN_ISO: u32 = 65_535;

/// Bytes at the beginning of a file that hold its EXIF, if it is built like a TIFF.
const EXIF_PREFIX: usize = 1 << 19;

/// Linear sRGB to XYZ of D65 (IEC 61966-2-1).
const XYZ_OF_SRGB: DMat3 = DMat3::from_cols(
    DVec3::new(0.412_390_8, 0.212_639_0, 0.019_330_8),
    DVec3::new(0.357_584_3, 0.715_168_7, 0.119_194_8),
    DVec3::new(0.180_480_8, 0.072_192_3, 0.950_532_2),
);

/// A raw file's camera and white balance.
#[derive(Clone, Debug, PartialEq)]
pub struct RawHeader {
    /// Make and model.
    pub camera: String,
    /// Multipliers of red, green and blue that make white neutral, as shot; green is 1.
    pub white_balance: [f32; 3],
    /// The library that reads the file in place of `flashraw`, such as `LibRaw 0.20.2`.
    pub reader: Option<String>,
}

/// A raw file whose header has been read and accepted.
pub(super) struct Raw {
    file: FlashRaw<'static>,
    bytes: u64,
    focal_px: Option<f64>,
    shot: Option<Shot>,
}

impl Raw {
    /// # Errors
    /// [`ImageError::Unsupported`] for a camera, sensor or compression that is not read,
    /// [`ImageError::Damaged`], [`ImageError::TooManyPixels`].
    pub(super) fn open(bytes: Vec<u8>) -> Result<Self, ImageError> {
        let length = bytes.len() as u64;
        let exif = own_exif(&bytes);
        let file = FlashRaw::open_with(bytes, limits()).map_err(|error| image_error(&error))?;
        let info = file.frame_info();
        let (width, height) = (info.crop.width, info.crop.height);
        if u64::from(info.width) * u64::from(info.height) > MAX_PIXELS {
            return Err(ImageError::TooManyPixels { width: info.width, height: info.height });
        }
        match info.layout {
            SensorLayout::Bayer
            | SensorLayout::QuadBayer
            | SensorLayout::XTrans
            | SensorLayout::Monochrome
            | SensorLayout::Linear => {}
            _ => {
                let message = "a sensor that is not Bayer, X-Trans, quad-Bayer or without colours";
                return Err(unsupported(message.to_owned()));
            }
        }
        check_samples(info)?;
        let (width, height) = (width as usize, height as usize);
        let of_equivalent = file.metadata().exposure.focal_length_35mm.map(f64::from);
        let focal_px = exif
            .as_ref()
            .and_then(|exif| exif::focal_px(exif, width, height))
            .or_else(|| exif::of_equivalent(of_equivalent?, width, height));
        let shot = exif.as_ref().and_then(exif::shot).or_else(|| shot(&file));
        Ok(Self { file, bytes: length, focal_px, shot })
    }

    /// Width and height of the upright picture, px.
    pub(super) fn size(&self) -> (usize, usize) {
        let crop = self.file.frame_info().crop;
        let (width, height) = (crop.width as usize, crop.height as usize);
        if self.orientation().to_exif() >= 5 { (height, width) } else { (width, height) }
    }

    pub(super) fn orientation(&self) -> Orientation {
        let exif = self.file.frame_info().orientation as u8;
        Orientation::from_exif(exif).unwrap_or(Orientation::NoTransforms)
    }

    pub(super) fn focal_px(&self) -> Option<f64> {
        self.focal_px
    }

    pub(super) fn shot(&self) -> Option<Shot> {
        self.shot
    }

    pub(super) fn header(&self) -> RawHeader {
        let camera = self.file.metadata().camera().chars().take(CAMERA_LENGTH).collect();
        let white_balance = white_balance(self.file.frame_info());
        RawHeader { camera, white_balance, reader: None }
    }

    /// Bytes that decoding needs: the file, its samples as integers and as floats, and the picture.
    pub(super) fn decoded_bytes(&self) -> u64 {
        let info = self.file.frame_info();
        let samples = u64::from(info.width) * u64::from(info.height) * u64::from(info.cpp);
        self.bytes.saturating_add(samples.saturating_mul(12))
    }

    /// The picture with its long side reduced to at most `long_side` px, balanced to
    /// `white_balance`, or as shot.
    ///
    /// # Errors
    /// [`ImageError::Damaged`], [`ImageError::Unsupported`].
    pub(super) fn light(
        &self,
        long_side: usize,
        white_balance: Option<[f32; 3]>,
    ) -> Result<Image<Linear>, ImageError> {
        let info = self.file.frame_info();
        let options = DecodeOptions {
            output: match info.sample_format {
                flashraw::SampleFormat::F32 => OutputFormat::RawF32,
                _ => OutputFormat::RawU16,
            },
            threads: Some(1),
            limits: limits(),
            corruption_policy: CorruptionPolicy::Strict,
            ..DecodeOptions::default()
        };
        let frame = self.file.decode(options).map_err(|error| image_error(&error))?;
        let (cpp, width) = (frame.cpp as usize, frame.width as usize);
        let mut samples = normalised(&frame, info);
        drop(frame);
        shade(&mut samples, info);
        let own = self.header().white_balance;
        let wanted = white_balance.unwrap_or(own);
        let balance = at_least_one(match info.white_balance_applied {
            true => [0, 1, 2].map(|channel| wanted[channel] / own[channel]),
            false => wanted,
        });
        let mosaic = Mosaic { samples: &samples, width, cpp, cfa: info.cfa, crop: info.crop };
        let (crop_width, crop_height) = (info.crop.width as usize, info.crop.height as usize);
        let size = at_most(crop_width, crop_height, long_side.max(1));
        let mut image = mosaic.averaged(size, balance);
        drop(samples);
        mixed(&mut image, &camera_to_srgb(info));
        Ok(turned(image, self.orientation()))
    }
}

/// The tags of a file that is built like a TIFF: they know more than decoders pass on.
pub(super) fn own_exif(bytes: &[u8]) -> Option<::exif::Exif> {
    let is_tiff = bytes.starts_with(b"II*\0") || bytes.starts_with(b"MM\0*");
    is_tiff.then(|| exif::read(bytes[..bytes.len().min(EXIF_PREFIX)].to_vec())).flatten()
}

/// # Errors
/// [`ImageError::RawUnread`] for samples that are not one colour of three each, or all three.
fn check_samples(info: &FrameInfo) -> Result<(), ImageError> {
    let is_other = |cfa: flashraw::CfaPattern| cfa.colors().iter().any(|c| channel(*c).is_none());
    if info.cfa.is_some_and(is_other) {
        let message = "a sensor of other colours than red, green and blue";
        return Err(unsupported(message.to_owned()));
    }
    if !matches!((info.cfa.is_some(), info.cpp), (true, 1) | (false, 1 | 3 | 4)) {
        return Err(unsupported(format!("{} samples a pixel", info.cpp)));
    }
    if (info.pixel_aspect - 1.0).abs() > 0.01 {
        return Err(unsupported("pixels that are not square".to_owned()));
    }
    Ok(())
}

/// The exposure that `flashraw` finds.
fn shot(file: &FlashRaw<'_>) -> Option<Shot> {
    let exposure = &file.metadata().exposure;
    let positive = |value: f64| (value.is_finite() && value > 0.0).then_some(value);
    let iso = exposure.iso.filter(|iso| *iso != UNKNOWN_ISO)?;
    Some(Shot {
        seconds: positive(exposure.exposure_time?)?,
        iso: positive(f64::from(iso))?,
        f_number: exposure.f_number.and_then(|f| positive(f64::from(f))),
    })
}

fn limits() -> Limits {
    Limits::default().with_max_samples(3 * MAX_PIXELS)
}

/// The samples without black, as shares of the white level.
fn normalised(frame: &RawFrame, info: &FrameInfo) -> Vec<f32> {
    let (cpp, width) = (frame.cpp as usize, frame.width as usize);
    let black = &frame.black_level;
    let levels = |index: usize| {
        let (x, y, sample) = (index / cpp % width, index / cpp / width, index % cpp);
        let colour = info.cfa.map_or(sample, |cfa| cfa.color_at(x, y) as usize);
        let black = black.at(x, y, sample);
        let white = frame.white_level.at(colour) as f32;
        (black, if white > black { (white - black).recip() } else { 1.0 })
    };
    let of = |(index, value): (usize, f32)| {
        let (black, scale) = levels(index);
        let value = (value - black) * scale;
        if value.is_finite() { value } else { 0.0 }
    };
    match &frame.data {
        RawPixelData::U16(samples) => {
            samples.iter().map(|v| f32::from(*v)).enumerate().map(of).collect()
        }
        RawPixelData::F32(samples) => samples.iter().copied().enumerate().map(of).collect(),
        // The two formats that are asked for.
        _ => Vec::new(),
    }
}

/// Applies the second list of a DNG's opcodes: gain maps against the lens's shading, and bad
/// pixels.
fn shade(samples: &mut [f32], info: &FrameInfo) {
    let Some(opcodes) = info.opcodes.as_ref().and_then(|lists| {
        let list = &lists.lists[1];
        dng_opcodes::parse(list).ok().filter(|all| !all.is_empty() && all.len() <= MAX_OPCODES)
    }) else {
        return;
    };
    let (area, cpp) = (info.active_area, info.cpp as usize);
    let start = (area.y as usize * info.width as usize + area.x as usize) * cpp;
    let mut active = PlaneImage {
        data: &mut samples[start..],
        width: area.width as usize,
        height: area.height as usize,
        planes: cpp,
        stride: info.width as usize,
        x0: 0,
        y0: 0,
        full_width: area.width as usize,
        full_height: area.height as usize,
    };
    let period = info.cfa.map_or(1, |cfa| cfa.width().max(cfa.height()));
    dng_opcodes::apply(&opcodes, &mut active, period, 65_535.0, false);
}

/// The multipliers that make white neutral, with green at 1: as shot, else for daylight by the
/// camera's matrix.
fn white_balance(info: &FrameInfo) -> [f32; 3] {
    if let Some(balance) = info.white_balance {
        return [balance.coeffs[0], 1.0, balance.coeffs[2]];
    }
    let Some(camera) = camera_of_srgb(info) else { return [1.0; 3] };
    let white = camera * DVec3::ONE;
    [white.y / white.x, 1.0, white.y / white.z].map(|v| v as f32)
}

/// With the smallest multiplier at 1: a sample at the white level stays white.
fn at_least_one(balance: [f32; 3]) -> [f32; 3] {
    let is_usable = |v: &f32| v.is_finite() && *v > 0.0;
    let least = balance.iter().copied().filter(is_usable).fold(f32::INFINITY, f32::min);
    balance.map(|v| if is_usable(&v) { v / least } else { 1.0 })
}

/// Linear sRGB to the camera's colours, before white balance.
fn camera_of_srgb(info: &FrameInfo) -> Option<DMat3> {
    let matrix = &info.color_matrices.preferred()?.values;
    let rows: [f64; 9] =
        matrix.get(..9)?.iter().map(|v| f64::from(*v)).collect::<Vec<_>>().try_into().ok()?;
    let camera = DMat3::from_cols_array(&rows).transpose() * XYZ_OF_SRGB;
    let is_usable = camera.is_finite() && camera.determinant().abs() > 1e-9;
    is_usable.then_some(camera)
}

/// From balanced colours of the camera to linear sRGB; white stays white. Without a matrix, the
/// camera's colours are taken for sRGB's.
fn camera_to_srgb(info: &FrameInfo) -> [[f32; 3]; 3] {
    let balanced = camera_of_srgb(info).filter(|_| info.cpp == 3 || info.cfa.is_some()).map(|of| {
        let white = of * DVec3::ONE;
        DMat3::from_diagonal(white.recip()) * of
    });
    let inverse = balanced.map_or(DMat3::IDENTITY, |of| of.inverse());
    let is_plausible = inverse.to_cols_array().iter().all(|v| v.abs() < LARGEST_ELEMENT);
    let inverse = if is_plausible { inverse } else { DMat3::IDENTITY };
    inverse.transpose().to_cols_array_2d().map(|row| row.map(|v| v as f32))
}

/// Turned upright.
fn turned(image: Image<Linear>, orientation: Orientation) -> Image<Linear> {
    let (width, height) = (image.width(), image.height());
    let (right, bottom) = (width - 1, height - 1);
    // Where a pixel of the upright picture comes from.
    let from: &dyn Fn(usize, usize) -> (usize, usize) = match orientation.to_exif() {
        2 => &|x, y| (right - x, y),
        3 => &|x, y| (right - x, bottom - y),
        4 => &|x, y| (x, bottom - y),
        5 => &|x, y| (y, x),
        6 => &|x, y| (y, bottom - x),
        7 => &|x, y| (right - y, bottom - x),
        8 => &|x, y| (right - y, x),
        _ => return image,
    };
    let is_quarter = orientation.to_exif() >= 5;
    let mut upright =
        if is_quarter { Image::new(height, width) } else { Image::new(width, height) };
    for y in 0..upright.height() {
        for x in 0..upright.width() {
            let (from_x, from_y) = from(x, y);
            upright.set(x, y, image.get(from_x, from_y));
        }
    }
    upright
}

/// The channel of a colour of a mosaic; `None` for colours that sRGB has not.
fn channel(colour: CfaColor) -> Option<usize> {
    match colour {
        CfaColor::Red => Some(0),
        CfaColor::Green => Some(1),
        CfaColor::Blue => Some(2),
        _ => None,
    }
}

fn unsupported(message: String) -> ImageError {
    ImageError::RawUnread { message }
}

fn image_error(error: &Error) -> ImageError {
    // It may quote the file.
    let message = error.to_string().chars().take(MESSAGE_LENGTH).collect();
    match error {
        Error::CorruptFile { .. } | Error::InvalidMetadata(_) => ImageError::Damaged { message },
        Error::LimitExceeded(_) | Error::OutOfMemory(_) => ImageError::Unsupported { message },
        _ => unsupported(message),
    }
}

#[cfg(test)]
mod tests;
