//! Identifies the format of a file by its first bytes; the extension is used only if the bytes are
//! ambiguous.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use image::ImageFormat;

/// The format according to a file's first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A format that is decoded here.
    Readable(ImageFormat),
    /// HEIC: the native format of phones. Its boxes show whether it contains HEVC.
    Heic,
    /// A camera's raw file.
    Raw,
    /// MP4 or MOV.
    Video,
    /// A known but unsupported format.
    Unread(Unread),
    /// Unknown.
    Unknown,
}

/// A known but unsupported format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unread {
    /// Its name.
    name: &'static str,
    sort: Sort,
}

/// The kind of advice for an unsupported format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sort {
    Picture,
    Video,
    Archive,
    Sphere,
    SphereVideo,
    /// Contradicts its name.
    Other,
}

impl Unread {
    const AVIF: Self = Self { name: "AVIF", sort: Sort::Picture };
    /// Two fisheyes side by side, in a JPEG.
    const INSTA360: Self = Self { name: "INSP photographs", sort: Sort::Sphere };
    /// Two fisheyes, or the faces of a cube, in an MP4.
    const SPHERES: Self = Self { name: "INSV and 360 videos", sort: Sort::SphereVideo };
    const BURST: Self = Self { name: "HEIC burst", sort: Sort::Picture };

    /// The format that a file's name claims, if it is known but unsupported.
    pub(crate) fn named(path: &Path) -> Option<Self> {
        let extension = extension(path);
        let known = |unread: &&(Self, &[u8], &[&str])| unread.2.contains(&extension.as_str());
        UNREAD.iter().find(known).map(|unread| unread.0)
    }

    /// The format of a file, from its first bytes or else its name, if it is known but unsupported.
    pub(crate) fn of(path: &Path) -> io::Result<Option<Self>> {
        let mut head = Vec::new();
        File::open(path)?.take(32).read_to_end(&mut head)?;
        Ok(match kind(&head, path) {
            Kind::Unread(format) => Some(format),
            _ => None,
        })
    }

    fn is_photograph(self) -> bool {
        matches!(self.sort, Sort::Picture | Sort::Sphere)
    }
}

impl fmt::Display for Unread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name;
        match self.sort {
            Sort::Picture => {
                write!(f, "{name} pictures are not read: save them as JPEG, PNG, TIFF or HEIC")
            }
            Sort::Video => write!(
                f,
                "{name} videos are not read: convert it to MP4, as with ffmpeg -i VIDEO out.mp4"
            ),
            Sort::Archive => write!(
                f,
                "{name} archives are not read: unpack it, and give the folder or a zip of it"
            ),
            Sort::Sphere => write!(
                f,
                "{name} are not read, as one picture has all directions: export flat pictures of \
                 them"
            ),
            Sort::SphereVideo => write!(
                f,
                "{name} are not read, as their frames have all directions: export flat (reframed) \
                 views of 60 to 100 degrees, as MP4 or as photographs"
            ),
            Sort::Other => write!(f, "no picture but {name}: get the original file"),
        }
    }
}

const fn unread(name: &'static str, sort: Sort) -> Unread {
    Unread { name, sort }
}

/// Formats that are recognised to be refused with advice: their first bytes (empty if not
/// distinctive) and their extensions.
const UNREAD: [(Unread, &[u8], &[&str]); 34] = [
    (unread("BMP", Sort::Picture), b"BM", &["bmp", "dib"]),
    (unread("GIF", Sort::Picture), b"GIF8", &["gif"]),
    (unread("JPEG XL", Sort::Picture), b"\xff\x0a", &["jxl"]),
    (unread("JPEG XL", Sort::Picture), b"\0\0\0\x0cJXL ", &[]),
    (unread("JPEG 2000", Sort::Picture), b"\0\0\0\x0cjP  ", &["jp2", "j2k", "jpf", "jpx"]),
    (unread("JPEG 2000", Sort::Picture), b"\xff\x4f\xff\x51", &[]),
    (unread("JPEG XR", Sort::Picture), b"II\xbc", &["jxr", "wdp"]),
    (Unread::AVIF, b"", &["avif", "avifs"]),
    (Unread::INSTA360, b"", &["insp"]),
    (unread("Photoshop", Sort::Picture), b"8BPS", &["psd", "psb"]),
    (unread("OpenEXR", Sort::Picture), b"\x76\x2f\x31\x01", &["exr"]),
    (unread("Radiance HDR", Sort::Picture), b"#?R", &["hdr"]),
    (unread("PNM", Sort::Picture), b"P6", &["ppm", "pgm", "pnm"]),
    (unread("TGA", Sort::Picture), b"", &["tga"]),
    (unread("Matroska or WebM", Sort::Video), b"\x1a\x45\xdf\xa3", &["mkv", "webm"]),
    (unread("WMV", Sort::Video), b"\x30\x26\xb2\x75", &["wmv", "asf"]),
    (unread("Flash", Sort::Video), b"FLV", &["flv"]),
    (unread("MPEG", Sort::Video), b"\0\0\x01\xba", &["mpg", "mpeg", "vob", "ts", "mts", "m2ts"]),
    (unread("AVI", Sort::Video), b"", &["avi"]),
    (unread("3GP", Sort::Video), b"", &["3gp", "3g2"]),
    (Unread::SPHERES, b"", &["insv", "360"]),
    (unread("damaged or inner ZIP", Sort::Archive), b"", &["zip"]),
    (unread("RAR", Sort::Archive), b"Rar!", &["rar"]),
    (unread("7z", Sort::Archive), b"7z\xbc\xaf", &["7z"]),
    (unread("gzip (tar.gz)", Sort::Archive), b"\x1f\x8b", &["gz", "tgz"]),
    (unread("bzip2 (tar.bz2)", Sort::Archive), b"BZh", &["bz2", "tbz", "tbz2"]),
    (unread("xz (tar.xz)", Sort::Archive), b"\xfd7zXZ", &["xz", "txz"]),
    (unread("Zstandard", Sort::Archive), b"\x28\xb5\x2f\xfd", &["zst", "tzst"]),
    (unread("tar", Sort::Archive), b"", &["tar"]),
    (unread("a PDF", Sort::Other), b"%PDF", &[]),
    (unread("a web page", Sort::Other), b"<!DOCTYPE", &[]),
    (unread("a web page", Sort::Other), b"<html", &[]),
    (unread("iCloud's stand-in for a file that it has not loaded", Sort::Other), b"", &["icloud"]),
    (unread("the pointer of Git LFS to a file", Sort::Other), b"version https://git-lfs", &[]),
];

/// Extensions of raw files, whose bytes may look like TIFF.
const RAW_EXTENSIONS: [&str; 26] = [
    "3fr", "arw", "cr2", "cr3", "crw", "dcr", "dng", "erf", "fff", "gpr", "iiq", "kdc", "mef",
    "mos", "mrw", "nef", "nrw", "orf", "pef", "raf", "rw2", "rwl", "sr2", "srf", "srw", "x3f",
];

/// Whether a file's name claims a camera's raw file.
pub(crate) fn is_named_raw(path: &Path) -> bool {
    RAW_EXTENSIONS.contains(&extension(path).as_str())
}

fn extension(path: &Path) -> String {
    let extension = path.extension().and_then(|extension| extension.to_str());
    extension.unwrap_or_default().to_ascii_lowercase()
}

/// The kind of a file, from its first 32 bytes (fewer if it is shorter) and its extension.
pub(super) fn kind(head: &[u8], path: &Path) -> Kind {
    match foreign(head) {
        Some(Kind::Video) if Unread::named(path) == Some(Unread::SPHERES) => {
            return Kind::Unread(Unread::SPHERES);
        }
        Some(kind) => return kind,
        None => {}
    }
    let is_big_tiff = head.starts_with(b"II\x2b\0") || head.starts_with(b"MM\0\x2b");
    match image::guess_format(head) {
        Ok(_) if extension(path) == "insp" => Kind::Unread(Unread::INSTA360),
        Ok(ImageFormat::Tiff) if is_named_raw(path) => Kind::Raw,
        Ok(
            format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP | ImageFormat::Tiff),
        ) => Kind::Readable(format),
        _ if is_named_raw(path) => Kind::Raw,
        _ if is_big_tiff => Kind::Readable(ImageFormat::Tiff),
        _ => Unread::named(path).map_or(Kind::Unknown, Kind::Unread),
    }
}

/// Formats that are rejected without calling a decoder.
fn foreign(head: &[u8]) -> Option<Kind> {
    if head.get(4..8) == Some(b"ftyp".as_slice()) {
        return Some(match head.get(8..12)? {
            b"crx " => Kind::Raw,
            b"heic" | b"heix" | b"heim" | b"heis" | b"mif1" | b"mif2" | b"heif" => Kind::Heic,
            b"hevc" | b"hevx" | b"msf1" => Kind::Unread(Unread::BURST),
            b"avif" | b"avis" => Kind::Unread(Unread::AVIF),
            b"qt  " | b"isom" | b"iso2" | b"iso4" | b"iso5" | b"iso6" | b"mp41" | b"mp42"
            | b"avc1" | b"M4V " => Kind::Video,
            _ => return None,
        });
    }
    let canon = head.starts_with(b"II*\0") && head.get(8..10) == Some(b"CR".as_slice());
    let raw: [&[u8]; 6] = [b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"\0MRM"];
    if canon || raw.iter().any(|signature| head.starts_with(signature)) {
        return Some(Kind::Raw);
    }
    let begins =
        |unread: &&(Unread, &[u8], &[&str])| !unread.1.is_empty() && head.starts_with(unread.1);
    UNREAD.iter().find(begins).map(|unread| Kind::Unread(unread.0))
}

/// Whether a file's name claims a picture: distinguishes a broken photograph from an unrelated file
/// beside the photographs.
pub(crate) fn named_like_a_photograph(path: &Path) -> bool {
    const READ: [&str; 13] = [
        "jpg", "jpeg", "jpe", "jfif", "mpo", "png", "webp", "tif", "tiff", "heic", "heif", "hif",
        "btf",
    ];
    READ.contains(&extension(path).as_str())
        || is_named_raw(path)
        || Unread::named(path).is_some_and(Unread::is_photograph)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phone_and_raw_formats_are_recognised_by_their_bytes_whatever_their_name() {
        let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic";
        assert_eq!(kind(heic, Path::new("a.jpg")), Kind::Heic);
        let video = b"\0\0\0\x14ftypqt  \0\0\0\0qt  ";
        assert_eq!(kind(video, Path::new("a.mov")), Kind::Video);
        let avif = b"\0\0\0\x18ftypavif\0\0\0\0mif1avif";
        assert_eq!(kind(avif, Path::new("a.heic")), Kind::Unread(Unread::AVIF));
        assert_eq!(kind(b"\0\0\0\x18ftypcrx \0\0\0\x01", Path::new("a.jpg")), Kind::Raw);
        assert_eq!(kind(b"II*\0\x10\0\0\0CR\x02\0", Path::new("a")), Kind::Raw);
        assert_eq!(kind(b"FUJIFILMCCD-RAW 0201", Path::new("a")), Kind::Raw);
    }

    #[test]
    fn a_tiff_is_readable_unless_its_extension_is_a_raw_formats() {
        let tiff = b"II*\0\x08\0\0\0\x0e\0\0\x01";
        assert_eq!(kind(tiff, Path::new("a.tif")), Kind::Readable(ImageFormat::Tiff));
        assert_eq!(kind(tiff, Path::new("a.NEF")), Kind::Raw);
        let fisheyes = kind(b"\xff\xd8\xff\xe1", Path::new("a.insp"));
        assert_eq!(fisheyes, Kind::Unread(Unread::INSTA360));
    }

    #[test]
    fn unsupported_formats_are_named_with_advice() {
        let message = |head: &[u8], name: &str| match kind(head, Path::new(name)) {
            Kind::Unread(format) => format.to_string(),
            other => panic!("{name}: {other:?}"),
        };
        let cases: [(&[u8], &str, &str); 11] = [
            (b"BM\x36\x10", "a.jpg", "BMP pictures are not read: save them"),
            (b"8BPS\0\x01", "a.psd", "Photoshop pictures"),
            (b"\xff\x0a\xfa", "a.jxl", "JPEG XL pictures"),
            (b"Rar!\x1a\x07", "a.zip", "RAR archives are not read: unpack it"),
            (b"7z\xbc\xaf\x27\x1c", "a.7z", "7z archives"),
            (b"\x1f\x8b\x08", "a.tar.gz", "gzip (tar.gz) archives"),
            (b"\x1a\x45\xdf\xa3", "a.mkv", "Matroska or WebM videos are not read: convert"),
            (b"<!DOCTYPE html>", "a.jpg", "a web page"),
            (b"\0\0\0\x18ftyp3gp5", "a.3gp", "3GP videos"),
            (b"\0\0\0\x20ftypavc1\0", "a.insv", "export flat (reframed) views"),
            (b"\0\0\0\x14ftypmp41\0", "GS01.360", "export flat (reframed) views"),
        ];
        for (head, name, words) in cases {
            let message = message(head, name);
            assert!(message.contains(words), "{name}: {message}");
        }
    }

    #[test]
    fn jpegs_of_phones_and_stereo_cameras_are_photographs_by_their_names() {
        for name in ["a.jfif", "A.MPO", "a.JPE", "a.bmp", "a.dng", "a.insp"] {
            assert!(named_like_a_photograph(Path::new(name)), "{name}");
        }
        for name in ["a.rar", "a.mkv", "a.txt", "a"] {
            assert!(!named_like_a_photograph(Path::new(name)), "{name}");
        }
    }

    #[test]
    fn text_named_jpg_is_unknown() {
        assert_eq!(kind(b"hello there, this is text", Path::new("a.jpg")), Kind::Unknown);
        assert_eq!(kind(b"", Path::new("a.jpg")), Kind::Unknown);
    }
}
