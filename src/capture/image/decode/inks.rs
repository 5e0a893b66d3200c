//! The inks of CMYK pictures: `image` converts them to RGB.
//!
//! They are in the channels of an RGBA picture, 0 for no ink, so that `image` can turn them.

use std::fs::File;
use std::io::{BufRead, Seek};
use std::path::Path;

use image::{DynamicImage, ImageBuffer};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::error::ImageError;
use super::{MAX_DECODE_BYTES, pages};

fn options() -> DecoderOptions {
    DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
}

/// Whether a JPEG's header declares inks.
pub(super) fn are_in_jpeg(file: impl BufRead + Seek) -> bool {
    let mut decoder = JpegDecoder::new_with_options(file, options());
    // Until it decodes, the decoder goes by Adobe's mark alone, which RGB may have, too.
    decoder.decode_headers().is_ok()
        && decoder.info().is_some_and(|info| info.components == 4)
        && matches!(decoder.input_colorspace(), Some(ColorSpace::CMYK | ColorSpace::YCCK))
}

/// # Errors
/// [`ImageError::Damaged`].
pub(super) fn of_jpeg(bytes: &[u8]) -> Result<DynamicImage, ImageError> {
    let damaged = |message: String| ImageError::Damaged { message };
    let of_decoder = |error| damaged(format!("its decoder says: {error}"));
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options());
    decoder.decode_headers().map_err(of_decoder)?;
    let stored = decoder.input_colorspace().filter(|space| space.num_components() == 4);
    let stored = stored.ok_or_else(|| damaged("it does not have four inks".to_owned()))?;
    decoder.set_options(options().jpeg_set_out_colorspace(stored));
    let mut samples = decoder.decode().map_err(of_decoder)?;
    for pixel in samples.chunks_exact_mut(4) {
        if stored == ColorSpace::YCCK {
            let [y, blue, red] = [0, 1, 2].map(|channel| f32::from(pixel[channel]));
            let (blue, red) = (blue - 128.0, red - 128.0);
            // JFIF's RGB is the paper that the inks leave, and JPEG stores that upside down.
            let inks = [y + 1.402 * red, y - 0.344_136 * blue - 0.714_136 * red, y + 1.772 * blue];
            pixel[..3].copy_from_slice(&inks.map(|ink| ink.round() as u8));
            pixel[3] = 255 - pixel[3];
        } else {
            // Adobe stores inks upside down, and most readers read what lacks its mark so, too.
            pixel.iter_mut().for_each(|ink| *ink = 255 - *ink);
        }
    }
    let (width, height) = decoder.dimensions().unwrap_or_default();
    let (width, height) = (width as u32, height as u32);
    let buffer = ImageBuffer::from_raw(width, height, samples);
    buffer.map(DynamicImage::ImageRgba8).ok_or_else(|| damaged("it is incomplete".to_owned()))
}

/// # Errors
/// [`ImageError::Io`], [`ImageError::Damaged`], [`ImageError::Unsupported`].
pub(super) fn of_tiff(path: &Path) -> Result<DynamicImage, ImageError> {
    let io = |source| ImageError::Io { path: path.to_owned(), source };
    let damaged = || ImageError::Damaged { message: "it is incomplete".to_owned() };
    let of_decoder = |error| ImageError::Damaged { message: format!("its decoder says: {error}") };
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_DECODE_BYTES as usize;
    limits.intermediate_buffer_size = MAX_DECODE_BYTES as usize;
    let file = pages::Paged::open(File::open(path).map_err(io)?).map_err(io)?;
    let mut decoder = Decoder::new(file).map_err(of_decoder)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(of_decoder)?;
    let mut samples = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut samples).map_err(of_decoder)?;
    if layout.planes > 1 {
        let message = "a CMYK TIFF with each ink apart; save it interleaved".to_owned();
        return Err(ImageError::Unsupported { message });
    }
    match samples {
        DecodingResult::U8(samples) => ImageBuffer::from_raw(width, height, samples)
            .map(DynamicImage::ImageRgba8)
            .ok_or_else(damaged),
        DecodingResult::U16(samples) => ImageBuffer::from_raw(width, height, samples)
            .map(DynamicImage::ImageRgba16)
            .ok_or_else(damaged),
        _ => Err(damaged()),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    #[test]
    fn rgb_with_adobes_mark_of_inks_has_none() {
        let mut jpeg = Cursor::new(Vec::new());
        let picture = DynamicImage::new_rgb8(16, 16);
        picture.write_to(&mut jpeg, image::ImageFormat::Jpeg).expect("written");
        let jpeg = jpeg.into_inner();
        for transform in 0..3 {
            let mark = [b"\xff\xee\0\x0eAdobe\0\x64\0\0\0\0".as_slice(), &[transform]].concat();
            let marked = [&jpeg[..2], &mark, &jpeg[2..]].concat();
            assert!(!are_in_jpeg(Cursor::new(marked)), "{transform}");
        }
        let inks = include_bytes!("../../../../tests/golden/photographs/inks.jpg");
        assert!(are_in_jpeg(Cursor::new(inks)));
    }
}
