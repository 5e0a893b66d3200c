//! Writing: PNG and JPEG, atomically.

use std::fs::{self, File};
use std::io::{self, Cursor, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::{Image, ImageError, Srgb};

/// How an image is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeFormat {
    /// PNG, 8 bit a channel.
    Png,
    /// PNG, 16 bit a channel.
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

    /// Interleaved 16-bit RGB, [height, width, 3], clipped and rounded to the nearest step.
    pub fn to_rgb16(&self) -> Vec<u16> {
        self.interleaved(|v| (v.clamp(0.0, 1.0) * 65_535.0).round() as u16)
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
                PngEncoder::new(&mut bytes).write_image(
                    &samples,
                    width,
                    height,
                    ExtendedColorType::Rgb16,
                )
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
        outcome.map_err(|error| ImageError::Encode { message: error.to_string() })?;
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

    fn interleaved<T>(&self, quantise: impl Fn(f32) -> T) -> Vec<T> {
        let (red, green, blue) = (self.plane(0), self.plane(1), self.plane(2));
        (0..self.pixels()).flat_map(|i| [red[i], green[i], blue[i]]).map(quantise).collect()
    }
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
