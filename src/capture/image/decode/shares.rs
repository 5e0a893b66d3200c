//! Masks: how much each pixel counts, from a separate picture or from alpha.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use image::metadata::Orientation;
use image::{DynamicImage, ImageFormat, Primitive};

use super::{AreaAverage, ImageError, Opened, guarded, image_error};
use crate::image::{Image, Linear};

/// Alpha from which a pixel counts in full: encoders leave some pixels at 254 instead of 255.
const OPAQUE: f32 = 0.98;

/// How much each pixel of a picture counts, in 255ths, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shares {
    pub(crate) width: usize,
    pub(crate) height: usize,
    plane: Vec<u8>,
}

impl Shares {
    /// At another size, 0 to 1, in all three channels.
    pub(crate) fn at(&self, width: usize, height: usize) -> Image<Linear> {
        let average = AreaAverage::new((self.width, self.height), (width, height));
        let mut plane = vec![0.0; width * height];
        let row = |y: usize, buffer: &mut [f32]| {
            let values = &self.plane[y * self.width..(y + 1) * self.width];
            buffer.iter_mut().zip(values).for_each(|(to, v)| *to = f32::from(*v) / 255.0);
        };
        average.plane(self.width, row, &mut plane);
        Image::from_planar(width, height, plane.repeat(3))
    }

    /// Swaps counted and uncounted.
    #[must_use]
    pub(crate) fn inverted(mut self) -> Self {
        self.plane.iter_mut().for_each(|share| *share = 255 - *share);
        self
    }
}

/// The non-black pixels of a mask, rotated by `orientation` rather than by its own EXIF. In lossy
/// formats, where black is noisy, pixels of at least half of white. If the colour is uniform,
/// transparent pixels are black.
///
/// # Errors
/// [`ImageError`].
pub(crate) fn of_picture(path: &Path, orientation: Orientation) -> Result<Shares, ImageError> {
    let least = if is_lossless(path) { f32::MIN_POSITIVE } else { 0.5 };
    shares(&decoded(path, orientation)?, &Rule::NotBlack(least))
}

/// The opacity of a photograph's pixels; `None` if all are opaque.
///
/// # Errors
/// [`ImageError`].
pub(crate) fn of_alpha(path: &Path) -> Result<Option<Shares>, ImageError> {
    let header = super::read_header(path)?;
    if !header.has_alpha {
        return Ok(None);
    }
    let shares = shares(&decoded(path, header.orientation)?, &Rule::Opaque)?;
    let is_opaque = shares.plane.iter().all(|share| *share == 255);
    Ok((!is_opaque).then_some(shares))
}

/// Which pixels count.
enum Rule {
    /// Those with at least this share of white.
    NotBlack(f32),
    /// By alpha.
    Opaque,
}

fn shares(picture: &DynamicImage, rule: &Rule) -> Result<Shares, ImageError> {
    use DynamicImage as D;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let channels = usize::from(picture.color().channel_count());
    let plane = match picture {
        D::ImageLuma8(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageLumaA8(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageRgb8(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageRgba8(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageLuma16(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageLumaA16(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageRgb16(buffer) => rule.plane(buffer.as_raw(), channels),
        D::ImageRgba16(buffer) => rule.plane(buffer.as_raw(), channels),
        other => {
            let message = format!("samples of type {:?}", other.color());
            return Err(ImageError::Unsupported { message });
        }
    };
    Ok(Shares { width, height, plane })
}

impl Rule {
    /// How much each pixel counts, in 255ths; grey and RGB have one or three channels, and alpha is
    /// an additional one.
    fn plane<T: Primitive>(&self, samples: &[T], channels: usize) -> Vec<u8> {
        let colours = if channels.is_multiple_of(2) { channels - 1 } else { channels };
        let opacity = |pixel: &[T]| pixel.get(colours).map_or(1.0, |alpha| share_of_white(*alpha));
        let pixels = samples.chunks_exact(channels);
        match self {
            Self::Opaque => pixels.map(|pixel| in_255ths(opacity(pixel))).collect(),
            Self::NotBlack(least) => {
                let first = samples.get(..colours);
                let is_plain = pixels.clone().any(|pixel| opacity(pixel) < 0.5)
                    && pixels.clone().all(|pixel| Some(&pixel[..colours]) == first);
                let is_white = |pixel: &[T]| {
                    let values = pixel[..colours].iter().map(|v| share_of_white(*v));
                    let brightest = values.fold(0.0, f32::max);
                    opacity(pixel) >= 0.5 && (is_plain || brightest >= *least)
                };
                pixels.map(|pixel| if is_white(pixel) { 255 } else { 0 }).collect()
            }
        }
    }
}

fn in_255ths(opacity: f32) -> u8 {
    if opacity >= OPAQUE { 255 } else { (opacity * 255.0) as u8 }
}

fn share_of_white<T: Primitive>(value: T) -> f32 {
    let of = |value: T| value.to_f32().expect("an integer sample");
    of(value) / of(T::DEFAULT_MAX_VALUE)
}

fn decoded(path: &Path, orientation: Orientation) -> Result<DynamicImage, ImageError> {
    guarded(|| {
        let opened = Opened::open(path)?;
        let mut picture =
            DynamicImage::from_decoder(opened.decoder).map_err(|error| image_error(&error))?;
        picture.apply_orientation(orientation);
        Ok(picture)
    })
}

fn is_lossless(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(32).read_to_end(&mut head));
    let format = read.ok().and_then(|_| image::guess_format(&head).ok());
    matches!(format, Some(ImageFormat::Png | ImageFormat::Tiff))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayAlphaImage, GrayImage, ImageEncoder, Luma, LumaA, RgbImage, RgbaImage};

    /// The shares of a mask.
    fn of_mask(save: impl FnOnce(&Path), name: &str) -> Vec<f32> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        save(&path);
        let shares = of_picture(&path, Orientation::NoTransforms).expect("a mask");
        shares.at(shares.width, shares.height).plane(0).to_vec()
    }

    #[test]
    fn black_is_masked_in_every_form_of_mask() {
        let grey = GrayImage::from_fn(2, 1, |x, _| Luma([x as u8]));
        assert_eq!(of_mask(|p| grey.save(p).expect("saved"), "labels.png"), [0.0, 1.0]);
        let rgb = RgbImage::from_fn(2, 1, |x, _| image::Rgb([0, 0, 200 * x as u8]));
        assert_eq!(of_mask(|p| rgb.save(p).expect("saved"), "rgb.png"), [0.0, 1.0]);
        let alpha = RgbaImage::from_fn(2, 1, |x, _| image::Rgba([0, 0, 0, 255 * x as u8]));
        assert_eq!(of_mask(|p| alpha.save(p).expect("saved"), "alpha.png"), [0.0, 1.0]);
        let both = GrayAlphaImage::from_fn(2, 1, |x, _| LumaA([255 * x as u8, 255]));
        assert_eq!(of_mask(|p| both.save(p).expect("saved"), "opaque.png"), [0.0, 1.0]);
        let cut = GrayAlphaImage::from_fn(2, 1, |x, _| LumaA([255 - x as u8, 255 * x as u8]));
        assert_eq!(of_mask(|p| cut.save(p).expect("saved"), "cut.png"), [0.0, 1.0]);
    }

    #[test]
    fn noise_of_a_jpeg_is_black() {
        let noisy = GrayImage::from_fn(16, 8, |x, _| Luma([if x < 8 { 3 } else { 250 }]));
        let save = |path: &Path| {
            let file = File::create(path).expect("made");
            image::codecs::jpeg::JpegEncoder::new_with_quality(file, 95)
                .write_image(noisy.as_raw(), 16, 8, image::ExtendedColorType::L8)
                .expect("saved");
        };
        let found = of_mask(save, "mask.jpg");
        assert!((0..128).all(|i| found[i] == f32::from(u8::from(i % 16 >= 8))), "{found:?}");
    }

    #[test]
    fn alpha_of_a_photograph_is_a_mask_if_a_pixel_is_transparent() {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |name: &str, alpha: [u8; 3]| {
            let path = folder.path().join(name);
            let image =
                RgbaImage::from_fn(3, 1, |x, _| image::Rgba([90, 80, 70, alpha[x as usize]]));
            image.save(&path).expect("saved");
            of_alpha(&path).expect("read").map(|shares| shares.at(3, 1).plane(0).to_vec())
        };
        assert_eq!(of("opaque.png", [255, 254, 255]), None);
        assert_eq!(of("cut.png", [255, 0, 255]), Some(vec![1.0, 0.0, 1.0]));
        let soft = of("cut.webp", [255, 51, 0]).expect("transparent");
        assert!((soft[1] - 0.2).abs() < 0.01 && soft[2] == 0.0, "{soft:?}");
    }
}
