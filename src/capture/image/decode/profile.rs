//! The colour declarations of each format.

use std::io::{BufRead, Read, Seek};

use exif::{Exif, In, Tag};
use image::ImageDecoder;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, Limits};

use crate::image::colour::{Channels, Colour};
use crate::image::hdr::HdrTransfer;

/// Largest ICC profile, bytes; those of printers have some mebibytes at most.
const LARGEST_PROFILE: usize = 4 << 20;

/// A colour declaration of a container that its decoder does not report.
pub(super) enum Declared {
    Colour(Colour),
    /// An ICC profile.
    Icc(Vec<u8>),
    /// One that is not supported, with the reason; the values are taken as sRGB.
    Unread(String),
}

/// The colours of a picture, and why its ICC profile is not applied, if it is not. What the
/// container declares comes first, then the decoder's ICC profile, then the cameras' mark of Adobe
/// RGB in EXIF (DCF 2.0: "R03"), which they write in place of a profile.
pub(super) fn of(
    decoder: &mut dyn ImageDecoder,
    channels: Channels,
    declared: Option<Declared>,
    exif: Option<&Exif>,
) -> (Colour, Option<String>) {
    let icc = match declared {
        Some(Declared::Colour(colour)) => return (colour, None),
        Some(Declared::Unread(reason)) => return (Colour::srgb(), Some(reason)),
        Some(Declared::Icc(bytes)) => Ok(Some(bytes)),
        None => decoder.icc_profile(),
    };
    match icc {
        Ok(Some(bytes)) if bytes.len() > LARGEST_PROFILE => {
            (Colour::srgb(), Some(format!("it has more than {} MiB", LARGEST_PROFILE >> 20)))
        }
        Ok(Some(bytes)) => match Colour::of_icc(&bytes, channels) {
            Ok(colour) => (colour, None),
            Err(reason) => (Colour::srgb(), Some(reason)),
        },
        Ok(None) if channels == Channels::Cmyk => {
            (Colour::srgb(), Some("it is CMYK and has none".to_owned()))
        }
        Ok(None) if exif.is_some_and(is_adobe_rgb) && channels == Channels::Rgb => {
            (Colour::adobe_rgb(), None)
        }
        Ok(None) => (Colour::srgb(), None),
        Err(error) => (Colour::srgb(), Some(error.to_string())),
    }
}

fn is_adobe_rgb(exif: &Exif) -> bool {
    let index = exif.get_field(Tag::InteroperabilityIndex, In::PRIMARY);
    let is_r03 = |value: &exif::Value| match value {
        exif::Value::Ascii(texts) => texts.iter().any(|text| text.starts_with(b"R03")),
        _ => false,
    };
    index.is_some_and(|field| is_r03(&field.value))
}

/// The colours of a PNG by other chunks than `iCCP`: `cICP` comes before it, `gAMA` and `cHRM`
/// after it and after `sRGB`. `None` leaves them to the profile, if any.
pub(super) fn of_png(file: &mut (impl BufRead + Seek)) -> Option<Declared> {
    // A broken header is for the decoder to report.
    let reader = png::Decoder::new(file).read_info().ok()?;
    let info = reader.info();
    if let Some(points) = info.coding_independent_code_points {
        let (primaries, transfer) = (points.color_primaries, points.transfer_function);
        if let Some(range) = HdrTransfer::of_code(transfer.into()) {
            return Some(Declared::Unread(format!("{range}, which is read in HEIC only")));
        }
        return Colour::of_code_points(primaries, transfer).map(Declared::Colour);
    }
    if info.icc_profile.is_some() || info.srgb.is_some() {
        return None;
    }
    let gamma = info.gama_chunk.map(png::ScaledFloat::into_value);
    let chromaticities = info.chrm_chunk.map(|of| {
        [of.white, of.red, of.green, of.blue].map(|(x, y)| [x.into_value(), y.into_value()])
    });
    let is_declared = gamma.is_some() || chromaticities.is_some();
    is_declared.then(|| Declared::Colour(Colour::of_gamma(gamma, chromaticities)))
}

/// The ICC profile of a TIFF's first page, which the picture's decoder leaves out if it is large
/// against the picture.
pub(super) fn of_tiff(file: &mut (impl Read + Seek)) -> Option<Vec<u8>> {
    let mut limits = Limits::default();
    // The decoder counts the values that it parses, not the bytes of the file.
    limits.decoding_buffer_size = LARGEST_PROFILE * size_of::<Value>();
    let mut decoder = Decoder::new(file).ok()?.with_limits(limits);
    decoder.get_tag_u8_vec(tiff::tags::Tag::IccProfile).ok()
}
