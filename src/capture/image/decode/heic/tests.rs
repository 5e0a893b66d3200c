use std::fs;
use std::path::PathBuf;

use exif::{Tag, Value};
use heifer::{EncodeOptions, Metadata};
use tempfile::TempDir;

use super::super::{ImageError, read_header};
use crate::image::exif::tests::block;
use crate::image::{HdrTransfer, Image, Srgb};

/// Red increases to the right, green downwards; `bit_depth` is per sample.
fn ramp(width: u32, height: u32, bit_depth: u8) -> heifer::Image {
    let top = (1_u32 << bit_depth) - 1;
    let mut picture = heifer::Image::filled(width, height, bit_depth, [0, 0, 0, top as u16]);
    for (i, pixel) in picture.data.chunks_exact_mut(4).enumerate() {
        let (x, y) = (i as u32 % width, i as u32 / width);
        pixel[0] = (x * top / (width - 1)) as u16;
        pixel[1] = (y * top / (height - 1)) as u16;
        pixel[2] = (top / 4) as u16;
    }
    picture
}

fn encoded(picture: &heifer::Image, metadata: &Metadata) -> Vec<u8> {
    let options = EncodeOptions { quality: 100, max_threads: 1 };
    heifer::encode_with_metadata(picture, metadata, &options).expect("encoded")
}

fn file(folder: &TempDir, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join("phone.heic");
    fs::write(&path, bytes).expect("written");
    path
}

/// The largest difference from the ramp, as a share of white. Chroma has half the resolution.
fn error(image: &Image<Srgb>) -> f32 {
    let (width, height) = (image.width(), image.height());
    let mut worst = 0.0_f32;
    for y in 2..height - 2 {
        for x in 2..width - 2 {
            let wanted = [x as f32 / (width - 1) as f32, y as f32 / (height - 1) as f32, 0.25];
            for (channel, wanted) in wanted.into_iter().enumerate() {
                worst = worst.max((image.plane(channel)[y * width + x] - wanted).abs());
            }
        }
    }
    worst
}

#[test]
fn a_phones_photograph_is_read_as_written_including_tiles() {
    let folder = TempDir::new().expect("folder");
    // Larger than a tile of the encoder, so this one is a grid.
    for (width, height, depth) in [(96, 64, 8), (700, 300, 8), (96, 64, 10)] {
        let path = file(&folder, &encoded(&ramp(width, height, depth), &Metadata::default()));
        let header = read_header(&path).expect("header");
        assert_eq!((header.width, header.height), (width as usize, height as usize));
        let image = Image::load(&path).expect("loaded");
        let worst = error(&image);
        assert!(worst < 0.03, "{width} x {height}, {depth} bits: {worst}");
    }
}

#[test]
fn ten_bits_stay_ten_bits() {
    let folder = TempDir::new().expect("folder");
    let path = file(&folder, &encoded(&ramp(512, 64, 10), &Metadata::default()));
    let image = Image::load(&path).expect("loaded");
    let row: Vec<u32> =
        image.plane(0)[32 * 512..33 * 512].iter().map(|v| (v * 65_535.0) as u32).collect();
    let mut levels = row.clone();
    levels.sort_unstable();
    levels.dedup();
    assert!(levels.len() > 300, "{} levels", levels.len());
}

#[test]
fn its_icc_profile_is_applied() {
    let folder = TempDir::new().expect("folder");
    let icc = moxcms::ColorProfile::new_display_p3().encode().expect("a profile");
    let metadata = Metadata { icc_profile: Some(icc), ..Metadata::default() };
    for depth in [8, 10] {
        let top = (1_u32 << depth) - 1;
        let value = |v: u32| (v * top / 255) as u16;
        let patch = [value(200), value(120), value(60), top as u16];
        let picture = heifer::Image::filled(96, 64, depth, patch);
        let path = file(&folder, &encoded(&picture, &metadata));
        let image = Image::<Srgb>::load(&path).expect("loaded");
        // By tests/golden/colour.py.
        for (value, wanted) in image.get(48, 32).into_iter().zip([213.0, 115.0, 42.4]) {
            assert!((255.0 * value - wanted).abs() < 2.0, "{depth} bits: {value} {wanted}");
        }
        let header = read_header(&path).expect("header");
        assert!(header.profile.is_some_and(|name| name.contains("P3")));
    }
}

#[test]
fn its_exif_focal_length_is_used_and_its_exif_orientation_ignored() {
    let folder = TempDir::new().expect("folder");
    let exif = block(&[
        (Tag::Orientation, Value::Short(vec![6])),
        (Tag::FocalLengthIn35mmFilm, Value::Short(vec![26])),
    ]);
    let metadata = Metadata { exif: Some(exif), ..Metadata::default() };
    let path = file(&folder, &encoded(&ramp(96, 64, 8), &metadata));
    let header = read_header(&path).expect("header");
    assert_eq!((header.width, header.height), (96, 64));
    let focal = header.focal_px.expect("a focal length");
    assert!((focal - 26.0 / 43.266_615 * 96_f64.hypot(64.0)).abs() < 0.01);
}

/// The container's `irot` rotates by quarter turns anticlockwise.
#[test]
fn the_containers_rotation_is_applied_once() {
    let folder = TempDir::new().expect("folder");
    let mut bytes = encoded(&ramp(96, 64, 8), &Metadata::default());
    let upright = Image::<Srgb>::load(&file(&folder, &bytes)).expect("loaded");
    turn(&mut bytes);
    let path = file(&folder, &bytes);
    let header = read_header(&path).expect("header");
    assert_eq!((header.width, header.height), (64, 96));
    let turned = Image::<Srgb>::load(&path).expect("loaded");
    // The right end of the first row is now the top of the first column.
    for x in 0..96 {
        let (was, is) = (upright.plane(0)[x], turned.plane(0)[(95 - x) * 64]);
        assert!((was - is).abs() < 1e-6, "{x}: {was} and {is}");
    }
}

/// Changes the first `pixi` property, which decoders do not need, into an `irot` of a quarter turn.
fn turn(bytes: &mut [u8]) {
    let at = bytes.windows(4).position(|window| window == b"pixi").expect("a pixi box");
    bytes[at..at + 4].copy_from_slice(b"irot");
    bytes[at + 4] = 1;
}

#[test]
fn a_truncated_file_or_another_codec_is_refused_with_a_reason() {
    let folder = TempDir::new().expect("folder");
    let whole = encoded(&ramp(96, 64, 8), &Metadata::default());
    for share in [0.1, 0.5, 0.9, 0.99] {
        let cut = &whole[..(whole.len() as f64 * share) as usize];
        let outcome = Image::<Srgb>::load(&file(&folder, cut));
        assert!(matches!(outcome, Err(ImageError::Damaged { .. })), "{share}: {outcome:?}");
    }
    let mut other = whole.clone();
    let at = other.windows(4).position(|window| window == b"hvc1");
    let at = at.expect("an item's type");
    other[at..at + 4].copy_from_slice(b"av01");
    let error = Image::<Srgb>::load(&file(&folder, &other)).expect_err("another codec");
    assert!(error.is_unsupported_format(), "{error}");
    assert!(error.to_string().contains("JPEG"), "{error}");
}

#[test]
fn any_wrong_byte_is_harmless() {
    let folder = TempDir::new().expect("folder");
    let whole = encoded(&ramp(96, 64, 8), &Metadata::default());
    // The boxes, which contain the sizes and counts, and part of the coded data.
    for at in 0..whole.len().min(900) {
        for value in [0x00, 0x7f, 0xff] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            // Read or refused: no panic and no unbounded memory.
            let _ = Image::<Srgb>::load(&file(&folder, &bytes));
        }
    }
}

/// A grid is defined by its item's data: version, flags, rows less one, columns less one, size.
#[test]
fn a_grid_with_tiles_outside_the_picture_is_refused() {
    let folder = TempDir::new().expect("folder");
    let whole = encoded(&ramp(700, 300, 8), &Metadata::default());
    let size_field = [0, 0, 0, 1, 2, 188, 1, 44];
    let at = whole.windows(8).position(|window| window == size_field);
    let at = at.expect("one row of two tiles, 700 x 300");
    for wrong in [[0, 0, 255, 255, 2, 188, 1, 44], [0, 0, 0, 1, 0, 100, 1, 44]] {
        let mut bytes = whole.clone();
        bytes[at..at + 8].copy_from_slice(&wrong);
        let error = read_header(&file(&folder, &bytes)).expect_err("refused");
        assert!(error.to_string().contains("tiles"), "{error}");
    }
}

#[test]
fn excessive_boxes_are_refused_before_they_are_read() {
    let folder = TempDir::new().expect("folder");
    let mut bytes = encoded(&ramp(96, 64, 8), &Metadata::default());
    let at = bytes.windows(4).position(|window| window == b"meta");
    let at = at.expect("a meta box") - 4;
    bytes[at..at + 4].copy_from_slice(&(600_u32 << 10).to_be_bytes());
    let error = read_header(&file(&folder, &bytes)).expect_err("refused");
    assert!(error.to_string().contains("more pictures"), "{error}");
}

/// 16 px, in 2 x 2 blocks: 10, 203 and 1,000 nits of grey, and an orange of BT.2020 at the lower
/// left, as tests/golden/photographs.py prints them.
const LIGHT: [[f32; 3]; 4] = [[0.2466; 3], [0.8426; 3], [0.8185, 0.3646, 0.1437], [1.0; 3]];

#[test]
fn a_larger_range_becomes_srgb_as_in_videos() {
    let folder = TempDir::new().expect("folder");
    let files: [(HdrTransfer, &[u8]); 2] = [
        (HdrTransfer::Pq, include_bytes!("../../../../../tests/golden/photographs/pq.heic")),
        (HdrTransfer::Hlg, include_bytes!("../../../../../tests/golden/photographs/hlg.heic")),
    ];
    for (transfer, bytes) in files {
        // The stream declares the same as the container, which takes precedence.
        let mut silent = bytes.to_vec();
        let at = silent.windows(8).position(|window| window == b"colrnclx").expect("a colour box");
        silent[at..at + 4].copy_from_slice(b"skip");
        for bytes in [bytes, &silent[..]] {
            let path = file(&folder, bytes);
            assert_eq!(read_header(&path).expect("header").hdr, Some(transfer));
            let image = Image::<Srgb>::load(&path).expect("loaded");
            for (at, expected) in LIGHT.into_iter().enumerate() {
                let found = image.get(16 * (at % 2) + 8, 16 * (at / 2) + 8);
                let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs());
                let worst = worst.fold(0.0, f32::max);
                assert!(worst < 0.004, "{transfer} {at}: {found:?} for {expected:?}");
            }
        }
    }
}

/// Sets these code points in all colour boxes of a file.
fn recoded(mut bytes: Vec<u8>, primaries: u8, transfer: u8, matrix: u8) -> Vec<u8> {
    let boxes = bytes.windows(8).enumerate().filter(|(_, window)| window == b"colrnclx");
    let boxes: Vec<usize> = boxes.map(|(at, _)| at + 8).collect();
    assert!(!boxes.is_empty(), "a colour box");
    for at in boxes {
        bytes[at..at + 6].copy_from_slice(&[0, primaries, 0, transfer, 0, matrix]);
    }
    bytes
}

#[test]
fn the_containers_range_takes_precedence_in_eight_bits_and_grids_too() {
    let folder = TempDir::new().expect("folder");
    for (width, depth) in [(96, 8), (700, 8), (96, 10)] {
        let bytes = encoded(&ramp(width, 64, depth), &Metadata::default());
        let usual = file(&folder, &bytes);
        assert_eq!(read_header(&usual).expect("header").hdr, None);
        let path = file(&folder, &recoded(bytes, 1, 16, 6));
        assert_eq!(read_header(&path).expect("header").hdr, Some(HdrTransfer::Pq));
        let image = Image::<Srgb>::load(&path).expect("loaded");
        // Upper left: a quarter of the range of PQ in blue, 5.2 nits.
        let blue = image.get(4, 4)[2];
        assert!((blue - 0.172).abs() < 0.02, "{width} {depth}: {blue}");
    }
}

#[test]
fn colours_with_an_unsupported_matrix_are_refused() {
    let folder = TempDir::new().expect("folder");
    let bytes = encoded(&ramp(96, 64, 8), &Metadata::default());
    for (matrix, is_read) in [(1, true), (6, true), (9, true), (8, false), (14, false)] {
        let path = file(&folder, &recoded(bytes.clone(), 1, 13, matrix));
        let outcome = Image::<Srgb>::load(&path);
        assert_eq!(outcome.is_ok(), is_read, "{matrix}");
        if let Err(error) = outcome {
            assert!(error.is_unsupported_format(), "{error}");
            assert!(error.to_string().contains(&format!("matrix {matrix}")), "{error}");
        }
    }
}
