//! Golden pixels of every accepted kind of file, and the results for broken ones.

use super::*;
use crate::image::exif::tests::block;
use crate::image::linear_to_srgb;
use ::exif::{Tag, Value};
use image::{ExtendedColorType, ImageEncoder};
use std::fs;
use std::path::PathBuf;

/// Writes bytes under a name and returns the path (the caller keeps the folder alive).
fn file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("written");
    path
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn png(samples: &[u8], width: u32, height: u32, color: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(samples, width, height, color)
        .expect("encoded");
    bytes
}

fn close(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6)
}

#[test]
fn grey_alpha_and_sixteen_bits_have_their_defined_pixels() {
    let folder = folder();
    let load = |name: &str, bytes: &[u8]| Image::load(&file(&folder, name, bytes)).expect("read");
    let grey = load("grey.png", &png(&[0, 51, 255], 3, 1, ExtendedColorType::L8));
    assert!(close(grey.get(1, 0), [0.2; 3]) && close(grey.get(2, 0), [1.0; 3]));
    let alpha = load("alpha.png", &png(&[255, 102, 0, 128], 1, 1, ExtendedColorType::Rgba8));
    assert!(close(alpha.get(0, 0), [128.0 / 255.0, 51.0 / 255.0, 0.0]), "{:?}", alpha.get(0, 0));
    let grey_alpha = load("la.png", &png(&[200, 0, 200, 255], 2, 1, ExtendedColorType::La8));
    assert!(
        close(grey_alpha.get(0, 0), [0.0; 3]) && close(grey_alpha.get(1, 0), [200.0 / 255.0; 3])
    );
    let deep: Vec<u8> = [1_u16, 1000, 65_535].into_iter().flat_map(u16::to_ne_bytes).collect();
    let deep = load("deep.png", &png(&deep, 1, 1, ExtendedColorType::Rgb16));
    assert!(close(deep.get(0, 0), [1.0 / 65_535.0, 1000.0 / 65_535.0, 1.0]));
}

/// 16 px, in 2 x 2 blocks: made once by tests/golden/photographs.py (Pillow, tifffile, libheif).
const BLOCKS: [[u8; 3]; 4] = [[200, 40, 40], [40, 200, 40], [40, 40, 200], [230, 230, 60]];

#[test]
fn golden_files_of_other_encoders_have_their_defined_pixels() {
    let folder = folder();
    let expected = BLOCKS.map(|c| c.map(|v| f32::from(v) / 255.0));
    let files: [(&str, &[u8], f32); 8] = [
        ("palette.png", include_bytes!("../../../../tests/golden/photographs/palette.png"), 0.004),
        (
            "progressive.jpg",
            include_bytes!("../../../../tests/golden/photographs/progressive.jpg"),
            0.02,
        ),
        ("cmyk.jpg", include_bytes!("../../../../tests/golden/photographs/cmyk.jpg"), 0.03),
        (
            "lossless.webp",
            include_bytes!("../../../../tests/golden/photographs/lossless.webp"),
            0.004,
        ),
        (
            "lossless.heic",
            include_bytes!("../../../../tests/golden/photographs/lossless.heic"),
            0.004,
        ),
        ("deep.tif", include_bytes!("../../../../tests/golden/photographs/deep.tif"), 0.004),
        ("cmyk.tif", include_bytes!("../../../../tests/golden/photographs/cmyk.tif"), 0.01),
        ("turned.jpg", include_bytes!("../../../../tests/golden/photographs/turned.jpg"), 0.02),
    ];
    for (name, bytes, tolerance) in files {
        let image = Image::load(&file(&folder, name, bytes)).expect(name);
        assert_eq!((image.width(), image.height()), (32, 32), "{name}");
        for (block, colour) in expected.iter().enumerate() {
            let got = image.get(8 + 16 * (block % 2), 8 + 16 * (block / 2));
            let off = got.iter().zip(colour).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off <= tolerance, "{name} block {block}: {got:?} against {colour:?}");
        }
    }
}

/// A 3 x 2 grey picture with an orientation, whose upright form is always the same.
fn oriented(orientation: u16, value: Value, prefix: &[u8]) -> Vec<u8> {
    let upright = |x: usize, y: usize| 40 * (y * 3 + x) as u8;
    let (width, height) = if orientation >= 5 { (2, 3) } else { (3, 2) };
    let stored = (0..6).map(|i| {
        let (x, y) = (i % width, i / width);
        let (x, y) = match orientation {
            2 => (2 - x, y),
            3 => (2 - x, 1 - y),
            4 => (x, 1 - y),
            5 => (y, x),
            6 => (2 - y, x),
            7 => (2 - y, 1 - x),
            8 => (y, 1 - x),
            _ => (x, y),
        };
        upright(x, y)
    });
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder
        .set_exif_metadata([prefix, &block(&[(Tag::Orientation, value)])].concat())
        .expect("EXIF");
    encoder
        .write_image(
            &stored.collect::<Vec<_>>(),
            width as u32,
            height as u32,
            ExtendedColorType::L8,
        )
        .expect("encoded");
    bytes
}

#[test]
fn every_orientation_is_applied_once_in_header_and_pixels() {
    let folder = folder();
    let cases = (1..=8).flat_map(|orientation| {
        [
            (orientation, Value::Short(vec![orientation]), &b""[..]),
            (orientation, Value::Long(vec![orientation.into()]), b"Exif\0\0"),
        ]
    });
    for (orientation, value, prefix) in cases {
        let bytes = oriented(orientation, value, prefix);
        let path = file(&folder, "a.png", &bytes);
        let header = read_header(&path).expect("a header");
        assert_eq!((header.width, header.height), (3, 2), "orientation {orientation}");
        let image = Image::load(&path).expect("read");
        let row: Vec<u8> = image.plane(0).iter().map(|v| (v * 255.0).round() as u8).collect();
        let expected: Vec<u8> = (0..6).map(|i| 40 * i).collect();
        assert_eq!(row, expected, "orientation {orientation}");
    }
}

/// A page of one grey level: its side, px, the level, and its `NewSubfileType`.
fn page<K: tiff::encoder::TiffKind>(
    file: &mut tiff::encoder::TiffEncoder<File, K>,
    (side, level, kind): (u32, u8, u32),
) {
    use tiff::encoder::colortype::Gray8;
    let mut page = file.new_image::<Gray8>(side, side).expect("a page");
    let tags = page.encoder();
    tags.write_tag(tiff::tags::Tag::NewSubfileType, kind).expect("a tag");
    page.write_data(&vec![level; (side * side) as usize]).expect("written");
}

#[test]
fn the_largest_non_mask_page_of_a_tiff_or_bigtiff_is_read() {
    use tiff::encoder::TiffEncoder;
    let folder = folder();
    let path = folder.path().join("a.tif");
    let file = || File::create(&path).expect("a file");
    let check = |what: &str| {
        let header = read_header(&path).expect(what);
        assert_eq!((header.width, header.height), (20, 20), "{what}");
        let image = Image::load(&path).expect(what);
        assert!(close(image.get(9, 9), [0.8; 3]), "{what}: {:?}", image.get(9, 9));
    };
    // A thumbnail, the photograph, another, and the photograph's mask.
    let pages = [(8, 50, 1), (20, 204, 0), (20, 90, 0), (40, 255, 4)];
    for order in [[0, 1, 2, 3], [1, 0, 3, 2], [3, 0, 1, 2]] {
        let mut small = TiffEncoder::new(file()).expect("a TIFF");
        for at in order {
            page(&mut small, pages[at]);
        }
        drop(small);
        check("TIFF");
        let mut big = TiffEncoder::new_big(file()).expect("a TIFF");
        for at in order {
            page(&mut big, pages[at]);
        }
        drop(big);
        check("BigTIFF");
    }
}

#[test]
fn an_oversized_picture_is_refused_by_its_header() {
    let folder = folder();
    let mut bytes = png(&[0; 4], 2, 2, ExtendedColorType::L8);
    // IHDR: width and height at 16..24, the checksum at 29..33.
    bytes[16..20].copy_from_slice(&50_000_u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&50_000_u32.to_be_bytes());
    let checksum = crc32(&bytes[12..29]).to_be_bytes();
    bytes[29..33].copy_from_slice(&checksum);
    let error = Image::load(&file(&folder, "bomb.png", &bytes)).expect_err("too large");
    assert!(
        matches!(error, ImageError::TooManyPixels { width: 50_000, height: 50_000 }),
        "{error}"
    );
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0xedb8_8320 & (c & 1).wrapping_neg()))
    })
}

#[test]
fn broken_files_are_errors_that_name_the_fault() {
    let folder = folder();
    let load = |name: &str, bytes: &[u8]| Image::load(&file(&folder, name, bytes)).expect_err(name);
    assert!(matches!(load("empty.jpg", b""), ImageError::Empty));
    assert!(matches!(
        load("text.jpg", b"this is a text, not a photograph"),
        ImageError::UnknownFormat
    ));
    assert!(matches!(
        load("phone.jpg", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic...."),
        ImageError::Damaged { .. }
    ));
    assert!(matches!(
        load("phone.jpg", b"\0\0\0\x18ftypavif\0\0\0\0mif1avif...."),
        ImageError::Unread(_)
    ));
    assert!(matches!(
        Image::load(folder.path()),
        Err(ImageError::UnknownFormat | ImageError::Io { .. })
    ));
    assert!(matches!(Image::load(&folder.path().join("none")), Err(ImageError::Io { .. })));
}

#[test]
fn a_truncated_file_is_damaged_in_every_format() {
    let folder = folder();
    let image = Image::<Srgb>::from_planar(
        64,
        64,
        (0..3 * 64 * 64).map(|i| ((i * 2_654_435_761_usize) >> 7 & 255) as f32 / 255.0).collect(),
    );
    let jpeg = image.encode(crate::image::EncodeFormat::Jpeg(90)).expect("encoded");
    let png = image.encode(crate::image::EncodeFormat::Png).expect("encoded");
    let webp: &[u8] = include_bytes!("../../../../tests/golden/photographs/lossless.webp");
    let tiff: &[u8] = include_bytes!("../../../../tests/golden/photographs/deep.tif");
    for (name, whole) in
        [("a.jpg", jpeg.as_slice()), ("a.png", &png), ("a.webp", webp), ("a.tif", tiff)]
    {
        assert!(Image::load(&file(&folder, name, whole)).is_ok(), "{name} whole");
        for length in [20, 33, whole.len() / 2, whole.len() * 9 / 10] {
            let outcome = Image::load(&file(&folder, name, &whole[..length]));
            assert!(outcome.is_err(), "{name} cut to {length} of {}", whole.len());
        }
    }
}

#[test]
fn shrinking_while_reading_averages_light_not_code_values() {
    let folder = folder();
    let path = file(&folder, "a.png", &png(&[0, 255, 255, 0], 2, 2, ExtendedColorType::L8));
    let image = Image::load_at_most(&path, 1).expect("read");
    assert!(close(image.get(0, 0), [linear_to_srgb(0.5); 3]), "{:?}", image.get(0, 0));
    let same = Image::load_at_most(&path, 100).expect("read");
    assert!(close(same.get(1, 0), [1.0; 3]) && close(same.get(0, 0), [0.0; 3]), "{same:?}");
}
