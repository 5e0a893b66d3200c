//! Why a file cannot be decoded, and the size limits.

use std::path::PathBuf;

use crate::image::signature::Unread;

/// Maximum number of pixels of a decoded photograph. The largest cameras in use produce 100 MP;
/// decoding one takes 300 MB.
pub const MAX_PIXELS: u64 = 100_000_000;

/// Maximum file size of a photograph, bytes: an uncompressed 16-bit TIFF of [`MAX_PIXELS`] fits.
pub const MAX_FILE_BYTES: u64 = 640 << 20;

/// Why a file could not be read or written as a picture.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// A video among photographs.
    #[error("a video; one that comes alone, in no zip or folder, is taken apart into photographs")]
    Video,
    /// A 360-degree panorama, according to its XMP and its shape.
    #[error(
        "a panorama of 360 degrees, which no one camera takes: cut it into overlapping pictures of \
         60 to 100 degrees"
    )]
    Panorama,
    /// A known but unsupported format.
    #[error("{0}")]
    Unread(Unread),
    /// The format is not recognised.
    #[error("not a JPEG, PNG, WebP, TIFF, HEIC or camera raw picture")]
    UnknownFormat,
    /// The header declares more pixels than the limit.
    #[error("{width} x {height} px is more than the {} megapixels that are accepted", MAX_PIXELS / 1_000_000)]
    TooManyPixels {
        /// Width in the header.
        width: u32,
        /// Height in the header.
        height: u32,
    },
    /// The file is longer than the limit.
    #[error("{bytes} bytes are more than the {MAX_FILE_BYTES} that are accepted")]
    TooManyBytes {
        /// The file's length.
        bytes: u64,
    },
    /// A known format in an unsupported variant, such as floating-point TIFF.
    #[error(
        "a variant that is not read: {message}; save it as JPEG, or as PNG or TIFF of 8 or 16 bits"
    )]
    Unsupported {
        /// The variant.
        message: String,
    },
    /// A raw file of a camera, sensor or compression that is not read.
    #[error(
        "a raw file that is not read: {message}; develop it to 16-bit TIFF or PNG with one fixed \
         brightness for all, as with dcraw_emu -T -6 -w -W -c 0 -g 2.4 12.92 FILE"
    )]
    RawUnread {
        /// The decoder's message.
        message: String,
    },
    /// A known format, but damaged or cut short.
    #[error("damaged or cut short: {message}")]
    Damaged {
        /// The decoder's message.
        message: String,
    },
    /// A mask whose shape differs from its photograph's.
    #[error("it has other proportions than its photograph")]
    OtherShape,
    /// The picture does not fit the output format.
    #[error("cannot be encoded: {message}")]
    Encode {
        /// The encoder's message.
        message: String,
    },
}

impl ImageError {
    /// Whether the format is known but unsupported (HTTP 415), as opposed to a damaged file.
    pub fn is_unsupported_format(&self) -> bool {
        matches!(
            self,
            Self::Video
                | Self::Panorama
                | Self::Unread(_)
                | Self::Unsupported { .. }
                | Self::RawUnread { .. }
        )
    }
}
