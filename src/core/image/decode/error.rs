//! Why a file is no picture, and how large one may be.

use std::path::PathBuf;

use crate::image::signature::Unread;

/// Most pixels of a photograph that is decoded. The largest cameras in use give 100 MP; decoding
/// one takes 300 MB.
pub const MAX_PIXELS: u64 = 100_000_000;

/// Most bytes of a photograph's file: an uncompressed 16-bit TIFF of [`MAX_PIXELS`] fits.
pub const MAX_FILE_BYTES: u64 = 640 << 20;

/// Why a file could not be read or written as a picture.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// A video among photographs.
    #[error("a video; one that comes alone, in no zip or folder, is taken apart into photographs")]
    Video,
    /// A panorama of all directions, by its XMP and its shape.
    #[error(
        "a panorama of 360 degrees, which no one camera takes: cut it into overlapping pictures of \
         60 to 100 degrees"
    )]
    Panorama,
    /// A format that is known and not read.
    #[error("{0}")]
    Unread(Unread),
    /// The bytes are no picture that is known.
    #[error("not a JPEG, PNG, WebP, TIFF or HEIC picture")]
    UnknownFormat,
    /// The header promises more than is accepted.
    #[error("{width} x {height} px is more than the {} megapixels that are accepted", MAX_PIXELS / 1_000_000)]
    TooManyPixels {
        /// Width in the header.
        width: u32,
        /// Height in the header.
        height: u32,
    },
    /// The file is longer than is accepted.
    #[error("{bytes} bytes are more than the {MAX_FILE_BYTES} that are accepted")]
    TooManyBytes {
        /// The file's length.
        bytes: u64,
    },
    /// A known format in a variant that is not read, such as floating-point TIFF.
    #[error(
        "a variant that is not read: {message}; save it as JPEG, or as PNG or TIFF of 8 or 16 bits"
    )]
    Unsupported {
        /// Which.
        message: String,
    },
    /// A known format, but broken or cut short.
    #[error("damaged or cut short: {message}")]
    Damaged {
        /// What the decoder said.
        message: String,
    },
    /// A mask that is not of its photograph's shape.
    #[error("it has other proportions than its photograph")]
    OtherShape,
    /// The picture does not fit the format that it should be written in.
    #[error("cannot be encoded: {message}")]
    Encode {
        /// What the encoder said.
        message: String,
    },
}

impl ImageError {
    /// Whether the format is known but not accepted (HTTP 415), as against a broken file.
    pub fn is_unsupported_format(&self) -> bool {
        matches!(self, Self::Video | Self::Panorama | Self::Unread(_) | Self::Unsupported { .. })
    }
}
