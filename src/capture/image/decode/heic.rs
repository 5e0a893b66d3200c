//! Phone HEIC files, with the interface of the other decoders.
//!
//! The declarations in a file's boxes are checked before a pixel is decoded: a photograph is one
//! coded picture or a grid of them, and nothing larger than declared is allocated. Rotation,
//! mirroring and clipping belong to the container and are applied here; EXIF's orientation only
//! repeats them.

use heifer::heifer_hevc_dec::nal::NalUnit;
use heifer::heifer_hevc_dec::params::ParameterSets;
use heifer::heifer_isobmff::HeifFile;
use heifer::heifer_isobmff::boxes::{ColorInfo, Property};
use heifer::{Error, Options};
use image::metadata::Orientation;
use image::{ColorType, ImageDecoder, ImageResult};

use super::error::{ImageError, MAX_PIXELS};
use crate::image::colour::Colour;
use crate::image::hdr::{HdrTransfer, primaries_to_srgb};

/// Coded margin allowed beyond the picture on each side, px: codecs code whole blocks.
const MARGIN: u64 = 64;
/// Pixels of a grid's tile, which may exceed the picture.
const TILE: u64 = 1 << 20;
/// Maximum file size, bytes: it is read whole. 100 megapixels take 30 MiB.
pub(super) const LONGEST: u64 = 128 << 20;
/// Maximum size of the metadata, bytes. Phones write 5,000; reading takes time quadratic in the
/// size.
const LONGEST_META: usize = 512 << 10;

/// A photograph whose boxes have been read; its pixels are decoded on request.
pub(super) struct Heic {
    bytes: Vec<u8>,
    /// Upright, px.
    size: (u32, u32),
    /// As coded: before cropping and rotation, px.
    coded: (u32, u32),
    is_deep: bool,
    /// For a larger brightness range, its transfer function and primaries.
    hdr: Option<(HdrTransfer, u16)>,
    coding: Option<Coding>,
    icc: Option<Vec<u8>>,
    exif: Option<Vec<u8>>,
}

/// How the values of a picture are coded, as code points of ITU-T H.273.
#[derive(Clone, Copy)]
struct Coding {
    primaries: u16,
    transfer: u16,
    matrix: u16,
}

impl Heic {
    /// Reads the boxes of a whole file.
    ///
    /// # Errors
    /// [`ImageError::Unsupported`] for files that are not photographs of a phone or camera, such as
    /// an overlay or another codec, [`ImageError::Damaged`] for broken boxes.
    pub(super) fn open(bytes: Vec<u8>) -> Result<Self, ImageError> {
        check_meta(&bytes)?;
        let file = HeifFile::parse(&bytes).map_err(|error| image_error(&error.into()))?;
        let first = coded_picture(&file).map_err(|error| image_error(&error))?;
        check_alpha(&file).map_err(|error| image_error(&error))?;
        let whole = coded_size(&file, file.primary_id).map_err(|error| image_error(&error))?;
        if u64::from(whole.0) * u64::from(whole.1) > MAX_PIXELS {
            let (width, height) = whole;
            return Err(ImageError::TooManyPixels { width, height });
        }
        let size = upright_size(&file, whole).map_err(|error| image_error(&error))?;
        let config = file.hevc_config(first).map_err(|error| image_error(&error.into()))?;
        let coding =
            coding(&file, &[file.primary_id, first]).map_err(|error| image_error(&error))?;
        let hdr = coding.and_then(|c| Some((HdrTransfer::of_code(c.transfer)?, c.primaries)));
        // For a larger range, 8 bits of sRGB lose too much.
        let is_deep = hdr.is_some() || config.is_some_and(|config| config.bit_depth_luma > 8);
        // Unreadable EXIF does not affect the photograph.
        let exif = file.exif(file.primary_id).ok().flatten();
        let icc = icc(&file, &[file.primary_id, first]);
        Ok(Self { is_deep, size, coded: whole, hdr, coding, icc, exif, bytes })
    }

    /// The colours that the file declares by code points.
    pub(super) fn colour(&self) -> Option<Colour> {
        let code = |code: u16| u8::try_from(code).ok();
        let coding = self.coding.filter(|_| self.icc.is_none())?;
        Colour::of_code_points(code(coding.primaries)?, code(coding.transfer)?)
    }

    /// The file's larger brightness range, if any.
    pub(super) fn hdr(&self) -> Option<HdrTransfer> {
        self.hdr.map(|(transfer, _)| transfer)
    }

    /// Bytes that decoding needs besides the samples: the file, the coded planes, and RGBA before
    /// and after a rotation.
    pub(super) fn bytes_beside(&self) -> u64 {
        let rgba = if self.is_deep { 8 } else { 4 };
        let pixels = u64::from(self.coded.0) * u64::from(self.coded.1);
        self.bytes.len() as u64 + pixels.saturating_mul(2 * rgba + 6)
    }

    fn options(&self) -> Options {
        let (width, height) = (u64::from(self.coded.0), u64::from(self.coded.1));
        Options {
            // Photographs are already decoded in parallel.
            max_threads: 1,
            max_pixels: ((width + MARGIN) * (height + MARGIN)).max(TILE),
        }
    }

    /// Decodes into interleaved samples without alpha, 8 or 16 bits deep.
    fn decode(&self, out: &mut [u8]) -> Result<(), ImageError> {
        if self.is_deep {
            let picture = heifer::decode_with_options(&self.bytes, &self.options());
            let picture = picture.map_err(|error| image_error(&error))?;
            self.check((picture.width, picture.height))?;
            let top = u32::from(picture.max_value());
            let deep = |v: u16| ((u32::from(v) * 65_535 + top / 2) / top) as u16;
            let pixels = picture.data.chunks_exact(4);
            if let Some((transfer, primaries)) = self.hdr {
                converted(pixels, top, transfer, primaries, out);
                return Ok(());
            }
            for (out, v) in
                out.chunks_exact_mut(2).zip(pixels.flat_map(|pixel| over_black(pixel, top)))
            {
                out.copy_from_slice(&deep(v).to_ne_bytes());
            }
        } else {
            let picture = heifer::decode_rgba8(&self.bytes, &self.options());
            let picture = picture.map_err(|error| image_error(&error))?;
            self.check((picture.width, picture.height))?;
            let pixels = picture.data.chunks_exact(4);
            let values = pixels.flat_map(|pixel| over_black(pixel, 255));
            out.iter_mut().zip(values).for_each(|(out, v)| *out = v as u8);
        }
        Ok(())
    }

    fn check(&self, decoded: (u32, u32)) -> Result<(), ImageError> {
        if decoded == self.size {
            return Ok(());
        }
        Err(ImageError::Damaged {
            message: format!(
                "{} x {} px where its header says {} x {}",
                decoded.0, decoded.1, self.size.0, self.size.1
            ),
        })
    }
}

impl ImageDecoder for Heic {
    fn dimensions(&self) -> (u32, u32) {
        self.size
    }

    fn color_type(&self) -> ColorType {
        if self.is_deep { ColorType::Rgb16 } else { ColorType::Rgb8 }
    }

    fn orientation(&mut self) -> ImageResult<Orientation> {
        Ok(Orientation::NoTransforms)
    }

    fn exif_metadata(&mut self) -> ImageResult<Option<Vec<u8>>> {
        Ok(self.exif.clone())
    }

    fn icc_profile(&mut self) -> ImageResult<Option<Vec<u8>>> {
        Ok(self.icc.clone())
    }

    fn read_image(self, out: &mut [u8]) -> ImageResult<()> {
        self.decode(out).map_err(|error| {
            let hint = image::error::ImageFormatHint::Name("HEIC".to_owned());
            // Keep only the message: the caller's error adds the rest.
            let words = match error {
                ImageError::Damaged { message } | ImageError::Unsupported { message } => message,
                other => other.to_string(),
            };
            image::ImageError::Decoding(image::error::DecodingError::new(hint, words))
        })
    }

    fn read_image_boxed(self: Box<Self>, out: &mut [u8]) -> ImageResult<()> {
        (*self).read_image(out)
    }
}

/// Refuses a file with excessive boxes, before any of them is stored.
fn check_meta(bytes: &[u8]) -> Result<(), ImageError> {
    let mut at = 0;
    while let Some(head) = bytes.get(at..at + 16) {
        let short = u32::from_be_bytes([head[0], head[1], head[2], head[3]]);
        let length = match short {
            0 => bytes.len() - at,
            1 => {
                let long: [u8; 8] = head[8..].try_into().unwrap_or_default();
                usize::try_from(u64::from_be_bytes(long)).unwrap_or(usize::MAX)
            }
            short => short as usize,
        };
        if head[4..8] == *b"meta" && length > LONGEST_META {
            return Err(ImageError::Unsupported {
                message: "more pictures in it than in a photograph".to_owned(),
            });
        }
        at = at.saturating_add(length.max(8));
    }
    Ok(())
}

/// The coded picture, or the first tile of the grid.
fn coded_picture(file: &HeifFile<'_>) -> Result<u32, Error> {
    coded_below(file, file.primary_id)?.ok_or_else(|| {
        Error::Unsupported("neither a picture of HEVC nor a grid of such".to_owned())
    })
}

/// The item that is coded first, for a picture coded as one or as a grid. `None` for others.
fn coded_below(file: &HeifFile<'_>, id: u32) -> Result<Option<u32>, Error> {
    let kind = |id| file.item(id).map(|item| item.item_type.0);
    match &kind(id)? {
        b"hvc1" => return Ok(Some(id)),
        b"grid" => {}
        _ => return Ok(None),
    }
    let tiles = file.referenced_items(id, b"dimg");
    for &tile in tiles {
        if kind(tile)? != *b"hvc1" {
            return Ok(None);
        }
    }
    let Some(&first) = tiles.first() else {
        return Ok(None);
    };
    // Every tile is decoded, so none may be outside the picture.
    let grid = file.grid(id)?;
    let (rows, columns) = (u64::from(grid.rows), u64::from(grid.columns));
    let (width, height) = coded_size(file, first)?;
    let is_filled = tiles.len() as u64 == rows * columns
        && (columns - 1) * u64::from(width) < u64::from(grid.output_width)
        && (rows - 1) * u64::from(height) < u64::from(grid.output_height);
    if !is_filled {
        return Err(Error::Invalid("its grid has other tiles than its size asks for"));
    }
    Ok(Some(first))
}

/// Checks every declared alpha picture, as it is decoded, too.
fn check_alpha(file: &HeifFile<'_>) -> Result<(), Error> {
    for aux in file.referencing_items(file.primary_id, b"auxl") {
        if coded_below(file, aux)?.is_none() {
            return Err(Error::Unsupported(
                "a picture beside it that is not coded by HEVC".to_owned(),
            ));
        }
    }
    Ok(())
}

/// Width and height before the container's crops and rotations.
fn coded_size(file: &HeifFile<'_>, id: u32) -> Result<(u32, u32), Error> {
    let size = file.image_size(id)?.ok_or(Error::Invalid("its size is missing"))?;
    if size.0 == 0 || size.1 == 0 {
        return Err(Error::Invalid("it has no pixels"));
    }
    Ok(size)
}

/// Width and height after the container's crops and rotations.
fn upright_size(file: &HeifFile<'_>, coded: (u32, u32)) -> Result<(u32, u32), Error> {
    let mut size = coded;
    for property in file.item_properties(file.primary_id)? {
        match *property {
            Property::CleanAperture { width, height, .. } => {
                let whole =
                    |(over, under): (u32, u32)| (f64::from(over) / f64::from(under)).round();
                size.0 = size.0.min(whole(width) as u32);
                size.1 = size.1.min(whole(height) as u32);
            }
            Property::Rotation(quarters) if quarters % 2 == 1 => size = (size.1, size.0),
            _ => (),
        }
    }
    if size.0 == 0 || size.1 == 0 {
        return Err(Error::Invalid("it has no pixels"));
    }
    Ok(size)
}

/// The coding of the first of these items that declares one, in its container or else its stream.
///
/// # Errors
/// [`Error::Unsupported`] for colours that its decoder would read as BT.601.
fn coding(file: &HeifFile<'_>, items: &[u32]) -> Result<Option<Coding>, Error> {
    for &item in items {
        let container = file.item_properties(item)?.find_map(|property| match *property {
            Property::Color(ColorInfo::Nclx { primaries, transfer, matrix, .. }) => {
                Some(Coding { primaries, transfer, matrix })
            }
            _ => None,
        });
        let coding = match (container, file.hevc_config(item)?) {
            (None, Some(config)) => coding_of_stream(&config.nal_units),
            (container, _) => container,
        };
        match coding {
            // YCgCo, ICtCp, constant luminance and the like.
            Some(Coding { matrix: matrix @ (8 | 10..), .. }) => {
                return Err(Error::Unsupported(format!("colours coded by matrix {matrix}")));
            }
            None => {}
            coding => return Ok(coding),
        }
    }
    Ok(None)
}

/// The ICC profile of the first of these items that has one.
fn icc(file: &HeifFile<'_>, items: &[u32]) -> Option<Vec<u8>> {
    let of = |item: &u32| {
        file.item_properties(*item).ok()?.find_map(|property| match property {
            Property::Color(ColorInfo::Icc(profile)) => Some(profile.clone()),
            _ => None,
        })
    };
    items.iter().find_map(of)
}

/// Colour parameters of the coded stream; its decoder reports damaged ones.
fn coding_of_stream(units: &[Vec<u8>]) -> Option<Coding> {
    let mut sets = ParameterSets::default();
    for unit in units {
        sets.add(&NalUnit::parse(unit).ok()?).ok()?;
    }
    let vui = sets.sps.iter().flatten().find_map(|sps| sps.vui.as_ref())?;
    Some(Coding {
        primaries: vui.colour_primaries.into(),
        transfer: vui.transfer_characteristics.into(),
        matrix: vui.matrix_coeffs.into(),
    })
}

/// Writes pixels of a larger range as 16-bit sRGB, over black.
fn converted<'a>(
    pixels: impl Iterator<Item = &'a [u16]>,
    top: u32,
    transfer: HdrTransfer,
    primaries: u16,
    out: &mut [u8],
) {
    let light: Vec<f32> = (0..=top).map(|v| transfer.light(v as f32 / top as f32)).collect();
    let to_srgb = primaries_to_srgb(primaries);
    for (out, pixel) in out.chunks_exact_mut(6).zip(pixels) {
        let share = f32::from(pixel[3]) / top as f32;
        let colour = [0, 1, 2].map(|channel| light[u32::from(pixel[channel]).min(top) as usize]);
        for (out, value) in out.chunks_exact_mut(2).zip(transfer.srgb(colour, to_srgb)) {
            out.copy_from_slice(&((value * share * 65_535.0).round() as u16).to_ne_bytes());
        }
    }
}

/// The colour of a straight-alpha pixel over black.
fn over_black<T: Copy + Into<u32>>(pixel: &[T], top: u32) -> [u16; 3] {
    let alpha = pixel[3].into();
    [0, 1, 2].map(|channel| ((pixel[channel].into() * alpha + top / 2) / top) as u16)
}

fn image_error(error: &Error) -> ImageError {
    let message = error.to_string();
    match error {
        Error::Unsupported(what) => ImageError::Unsupported { message: what.clone() },
        _ => ImageError::Damaged { message },
    }
}

#[cfg(test)]
mod tests;
