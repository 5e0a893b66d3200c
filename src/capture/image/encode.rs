//! Writing: PNG, JPEG, WebP and TIFF, atomically.

mod profile;

use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, Cursor, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use super::{Image, ImageError, Linear, Srgb};

/// How an image is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeFormat {
    /// PNG, 8 bit a channel.
    Png,
    /// PNG, 16 bit a channel, with the profile of sRGB.
    Png16,
    /// JPEG of this quality, 1..=100.
    Jpeg(u8),
    /// Lossless WebP, 8 bit a channel.
    Webp,
}

/// JPEG quality when only a file name gives the format: no visible loss in renders.
const DEFAULT_JPEG_QUALITY: u8 = 92;

impl EncodeFormat {
    /// By extension: `.jpg` and `.jpeg` give JPEG of quality 92, `.webp` lossless WebP, anything
    /// else 8-bit PNG.
    pub fn of(path: &Path) -> Self {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        if extension.eq_ignore_ascii_case("jpg") || extension.eq_ignore_ascii_case("jpeg") {
            return Self::Jpeg(DEFAULT_JPEG_QUALITY);
        }
        if extension.eq_ignore_ascii_case("webp") { Self::Webp } else { Self::Png }
    }
}

impl Image<Srgb> {
    /// Interleaved 8-bit RGB, [height, width, 3], clipped and rounded to the nearest step.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.interleaved(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
    }

    /// From interleaved 8-bit RGB, [height, width, 3].
    ///
    /// # Panics
    /// When the length is not `3 * width * height`: a fault of the caller.
    pub fn from_rgb8(width: usize, height: usize, rgb: &[u8]) -> Self {
        assert_eq!(rgb.len(), 3 * width * height, "interleaved data of {width}x{height}");
        let mut image = Self::new(width, height);
        for channel in 0..3 {
            let values = rgb.iter().skip(channel).step_by(3);
            image
                .plane_mut(channel)
                .iter_mut()
                .zip(values)
                .for_each(|(v, &byte)| *v = f32::from(byte) / 255.0);
        }
        image
    }

    /// Encodes to the bytes of a file.
    ///
    /// # Errors
    /// [`ImageError::Encode`] if the format cannot hold the image (a JPEG's side is at most
    /// 65,535).
    pub fn encode(&self, format: EncodeFormat) -> Result<Vec<u8>, ImageError> {
        let mut bytes = Cursor::new(Vec::new());
        let (width, height) = (self.width as u32, self.height as u32);
        let outcome = match format {
            EncodeFormat::Png => PngEncoder::new(&mut bytes).write_image(
                &self.to_rgb8(),
                width,
                height,
                ExtendedColorType::Rgb8,
            ),
            EncodeFormat::Png16 => {
                // The encoder wants native-endian bytes and swaps them itself.
                let samples: Vec<u8> =
                    self.to_rgb16().into_iter().flat_map(u16::to_ne_bytes).collect();
                let profile = profile::srgb().map_err(unencodable)?;
                let mut encoder = PngEncoder::new(&mut bytes);
                encoder.set_icc_profile(profile).map_err(unencodable)?;
                encoder.write_image(&samples, width, height, ExtendedColorType::Rgb16)
            }
            EncodeFormat::Jpeg(quality) => JpegEncoder::new_with_quality(
                &mut bytes,
                quality.clamp(1, 100),
            )
            .write_image(&self.to_rgb8(), width, height, ExtendedColorType::Rgb8),
            EncodeFormat::Webp => WebPEncoder::new_lossless(&mut bytes).write_image(
                &self.to_rgb8(),
                width,
                height,
                ExtendedColorType::Rgb8,
            ),
        };
        outcome.map_err(unencodable)?;
        Ok(bytes.into_inner())
    }

    /// Writes a file in the format of its extension (see [`EncodeFormat::of`]), atomically.
    ///
    /// # Errors
    /// [`ImageError::Encode`], or [`ImageError::Io`] naming the path.
    pub fn save(&self, path: &Path) -> Result<(), ImageError> {
        self.save_as(path, EncodeFormat::of(path))
    }

    /// Writes a file in a given format, atomically.
    ///
    /// # Errors
    /// As [`Image::save`].
    pub fn save_as(&self, path: &Path, format: EncodeFormat) -> Result<(), ImageError> {
        write_atomic(path, &self.encode(format)?)
            .map_err(|source| ImageError::Io { path: path.to_owned(), source })
    }
}

impl Image<Linear> {
    /// Encodes to a TIFF of 16 bits a channel in linear light, clipped, with a profile that says
    /// so.
    ///
    /// # Errors
    /// [`ImageError::Encode`] if the image is too large for a TIFF.
    pub fn to_tiff(&self) -> Result<Vec<u8>, ImageError> {
        let profile = profile::linear_srgb().map_err(unencodable)?;
        let samples = self.to_rgb16();
        let mut bytes = Cursor::new(Vec::new());
        let (width, height) = (self.width as u32, self.height as u32);
        let mut write = || {
            let mut file = TiffEncoder::new(&mut bytes)?;
            let mut image = file.new_image::<colortype::RGB16>(width, height)?;
            image.encoder().write_tag(Tag::IccProfile, profile.as_slice())?;
            image.write_data(&samples)
        };
        write().map_err(unencodable)?;
        Ok(bytes.into_inner())
    }

    /// Writes [`Image::to_tiff`] to a file, atomically.
    ///
    /// # Errors
    /// [`ImageError::Encode`], or [`ImageError::Io`] naming the path.
    pub fn save_tiff(&self, path: &Path) -> Result<(), ImageError> {
        write_atomic(path, &self.to_tiff()?)
            .map_err(|source| ImageError::Io { path: path.to_owned(), source })
    }
}

impl<E> Image<E> {
    /// Interleaved 16-bit RGB, [height, width, 3], clipped and rounded to the nearest step.
    pub fn to_rgb16(&self) -> Vec<u16> {
        self.interleaved(|v| (v.clamp(0.0, 1.0) * 65_535.0).round() as u16)
    }

    fn interleaved<T>(&self, quantise: impl Fn(f32) -> T) -> Vec<T> {
        let (red, green, blue) = (self.plane(0), self.plane(1), self.plane(2));
        (0..self.pixels()).flat_map(|i| [red[i], green[i], blue[i]]).map(quantise).collect()
    }
}

fn unencodable(error: impl Display) -> ImageError {
    ImageError::Encode { message: error.to_string() }
}

/// Writes a file atomically: to a temporary name in the same folder, flushed to disk, then renamed
/// over the target. A reader sees either the old or the new bytes, never a part.
///
/// # Errors
/// The file system's error; the temporary file is removed.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
    let name = path.file_name().ok_or_else(|| io::Error::other("no file name"))?.to_string_lossy();
    // A name of 255 bytes must not grow: the temporary name keeps only its start.
    let start: String = name.chars().take(40).collect();
    let temporary = path.with_file_name(format!(".{start}.{}.{unique}.tmp", std::process::id()));
    let outcome = write_synced(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
    if outcome.is_err() {
        // Report the first error; a file that cannot be removed is hidden and small.
        let _ = fs::remove_file(&temporary);
    }
    outcome
}

fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create_new(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Image<Srgb> {
        let data = (0..3 * 12 * 7).map(|i| (i as f32 * 0.37).sin() * 0.5 + 0.5).collect();
        Image::from_planar(12, 7, data)
    }

    #[test]
    fn lossless_formats_round_trip_to_half_a_step() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let image = picture();
        for (name, format, step) in [
            ("a.png", EncodeFormat::Png, 255.0),
            ("b.png", EncodeFormat::Png16, 65_535.0),
            ("c.webp", EncodeFormat::Webp, 255.0),
        ] {
            let path = folder.path().join(name);
            image.save_as(&path, format).expect("written");
            let back = Image::load(&path).expect("read");
            let worst = image
                .data()
                .iter()
                .zip(back.data())
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f32::max);
            assert!(worst <= 0.5001 / step, "{name}: {worst}");
        }
    }

    #[test]
    fn a_linear_tiff_is_read_back_as_the_light_that_it_holds() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.tif");
        let light = picture().to_linear().map(|v| 0.02 * v);
        write_atomic(&path, &light.to_tiff().expect("encoded")).expect("written");
        let back = Image::load_light(&path, usize::MAX).expect("read");
        for (wanted, got) in light.data().iter().zip(back.data()) {
            assert!((wanted - got).abs() < 1.5 / 65_535.0, "{wanted} {got}");
        }
    }

    #[test]
    fn deep_pictures_say_that_they_are_srgb_and_linear_ones_that_they_are_not() {
        use ::image::ImageDecoder;
        let deep = picture().encode(EncodeFormat::Png16).expect("encoded");
        let mut png = ::image::codecs::png::PngDecoder::new(Cursor::new(deep)).expect("a PNG");
        assert_eq!(png.color_type(), ::image::ColorType::Rgb16);
        let name = |icc: Option<Vec<u8>>| {
            let profile = moxcms::ColorProfile::new_from_slice(&icc.expect("has one"));
            format!("{:?}", profile.expect("a profile").description)
        };
        assert!(name(png.icc_profile().expect("read")).contains("\"sRGB IEC61966-2.1\""));
        let linear = picture().to_linear().to_tiff().expect("encoded");
        let mut tiff = tiff::decoder::Decoder::new(Cursor::new(linear)).expect("a TIFF");
        let icc = tiff.get_tag_u8_vec(Tag::IccProfile).ok();
        assert!(name(icc).contains("\"linear sRGB\""));
    }

    #[test]
    fn values_outside_the_range_are_clipped_not_wrapped() {
        let image = Image::<Srgb>::from_planar(1, 1, vec![-0.5, 1.5, f32::NAN]);
        assert_eq!(image.to_rgb8(), [0, 255, 0]);
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.txt");
        write_atomic(&path, b"old").expect("written");
        write_atomic(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("read"), b"new");
        assert!(write_atomic(&folder.path().join("missing/a.txt"), b"x").is_err());
        assert!(write_atomic(&folder.path().join(""), b"x").is_err());
        assert_eq!(fs::read_dir(folder.path()).expect("listed").count(), 1);
    }
}
