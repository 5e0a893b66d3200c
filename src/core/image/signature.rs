//! Which kind of picture a file is, told by its first bytes; the extension only helps where the
//! bytes cannot tell.

use std::path::Path;

use image::ImageFormat;

/// What a file's first bytes say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// One that is decoded here.
    Readable(ImageFormat),
    /// HEIC: a phone's own format. Whether HEVC is inside, its boxes tell.
    Heic,
    /// AVIF, or a sequence of pictures.
    Avif,
    /// MP4 or MOV.
    Video,
    /// A camera's raw format.
    Raw,
    /// Nothing known.
    Unknown,
}

/// Extensions of raw files whose bytes look like TIFF.
const RAW_EXTENSIONS: [&str; 19] = [
    "3fr", "arw", "cr2", "cr3", "crw", "dcr", "dng", "erf", "kdc", "mef", "mos", "mrw", "nef",
    "nrw", "orf", "pef", "raf", "rw2", "srw",
];

/// The kind of a file, from its first 32 bytes (fewer if it is shorter) and its extension.
pub(super) fn kind(head: &[u8], path: &Path) -> Kind {
    if let Some(kind) = foreign(head) {
        return kind;
    }
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    match image::guess_format(head) {
        Ok(ImageFormat::Tiff) if RAW_EXTENSIONS.contains(&extension.as_str()) => Kind::Raw,
        Ok(
            format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP | ImageFormat::Tiff),
        ) => Kind::Readable(format),
        _ => Kind::Unknown,
    }
}

/// Formats that are recognised in order to be refused with advice.
fn foreign(head: &[u8]) -> Option<Kind> {
    if head.get(4..8) == Some(b"ftyp".as_slice()) {
        return Some(match head.get(8..12)? {
            b"crx " => Kind::Raw,
            b"heic" | b"heix" | b"heim" | b"heis" | b"mif1" | b"mif2" | b"heif" => Kind::Heic,
            b"hevc" | b"hevx" | b"msf1" | b"avif" | b"avis" => Kind::Avif,
            b"qt  " | b"isom" | b"iso2" | b"iso4" | b"iso5" | b"iso6" | b"mp41" | b"mp42"
            | b"avc1" | b"M4V " => Kind::Video,
            _ => Kind::Unknown,
        });
    }
    let canon = head.starts_with(b"II*\0") && head.get(8..10) == Some(b"CR".as_slice());
    let raw: [&[u8]; 6] = [
        b"FUJIFILMCCD-RAW",
        b"IIRO",
        b"IIRS",
        b"MMOR",
        b"IIU\0",
        b"\0MRM",
    ];
    (canon || raw.iter().any(|signature| head.starts_with(signature))).then_some(Kind::Raw)
}

/// Whether a file of this name claims to be a picture: used to tell a broken photograph from a
/// file that merely lies beside the photographs.
pub(crate) fn named_like_a_photograph(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    matches!(
        extension.as_str(),
        "jpg"
            | "jpeg"
            | "jpe"
            | "png"
            | "webp"
            | "tif"
            | "tiff"
            | "heic"
            | "heif"
            | "hif"
            | "avif"
            | "bmp"
            | "gif"
            | "jxl"
            | "jp2"
    ) || RAW_EXTENSIONS.contains(&extension.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phone_and_raw_formats_are_told_by_their_bytes_whatever_their_name() {
        let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic";
        assert_eq!(kind(heic, Path::new("a.jpg")), Kind::Heic);
        let video = b"\0\0\0\x14ftypqt  \0\0\0\0qt  ";
        assert_eq!(kind(video, Path::new("a.mov")), Kind::Video);
        let avif = b"\0\0\0\x18ftypavif\0\0\0\0mif1avif";
        assert_eq!(kind(avif, Path::new("a.heic")), Kind::Avif);
        assert_eq!(
            kind(b"\0\0\0\x18ftypcrx \0\0\0\x01", Path::new("a.jpg")),
            Kind::Raw
        );
        assert_eq!(kind(b"II*\0\x10\0\0\0CR\x02\0", Path::new("a")), Kind::Raw);
        assert_eq!(kind(b"FUJIFILMCCD-RAW 0201", Path::new("a")), Kind::Raw);
    }

    #[test]
    fn a_tiff_is_readable_unless_its_extension_is_a_raw_formats() {
        let tiff = b"II*\0\x08\0\0\0\x0e\0\0\x01";
        assert_eq!(
            kind(tiff, Path::new("a.tif")),
            Kind::Readable(ImageFormat::Tiff)
        );
        assert_eq!(kind(tiff, Path::new("a.NEF")), Kind::Raw);
    }

    #[test]
    fn text_named_jpg_is_nothing_known() {
        assert_eq!(
            kind(b"hello there, this is text", Path::new("a.jpg")),
            Kind::Unknown
        );
        assert_eq!(kind(b"", Path::new("a.jpg")), Kind::Unknown);
    }
}
