//! Intact JPEGs of every kind, and damage inside them.

use std::fs;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::image::{Image, ImageError, Srgb};

/// 160 x 120 px: made by tests/golden/photographs.py (Pillow).
const SCENES: [&[u8]; 4] = [
    include_bytes!("../../../../../tests/golden/photographs/scene.jpg"),
    include_bytes!("../../../../../tests/golden/photographs/scene-restart.jpg"),
    include_bytes!("../../../../../tests/golden/photographs/scene-progressive.jpg"),
    // With restart markers, and an edge in the scene that reaches the border along a row of blocks.
    include_bytes!("../../../../../tests/golden/photographs/scene-edge.jpg"),
];

fn load(bytes: &[u8]) -> Result<Image<Srgb>, ImageError> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.jpg");
    fs::write(&path, bytes).expect("written");
    Image::load(&path)
}

/// Offset of the first scan's data.
fn first_scan(jpeg: &[u8]) -> usize {
    let marker = |pair: &[u8]| pair == [0xff, 0xda];
    let at = jpeg.windows(2).position(marker).expect("a scan");
    at + 2 + super::number(&jpeg[at + 2..])
}

#[test]
fn bytes_after_a_complete_picture_and_a_missing_end_are_harmless() {
    for scene in SCENES {
        let truth = load(scene).expect("read");
        assert_eq!((truth.width(), truth.height()), (160, 120));
        let without_end = &scene[..scene.len() - 2];
        let trailers: [&[u8]; 5] = [
            b"",
            b"a trailer of a phone, SEFT",
            // A second picture, as in an MPO.
            scene,
            b"\0\0\0\0\0\0",
            b"PK\x03\x04 a film",
        ];
        for trailer in trailers {
            let cut = [without_end, trailer].concat();
            assert_eq!(load(&cut).expect("read"), truth, "{trailer:?}");
            let whole = [scene, trailer].concat();
            assert_eq!(load(&whole).expect("read"), truth, "{trailer:?}");
        }
    }
}

#[test]
fn a_truncated_scan_reports_how_much_is_intact() {
    let scene = SCENES[0];
    let from = first_scan(scene);
    let half = from + (scene.len() - from) / 2;
    let false_marker = [&scene[..half], &[0xff, 0x9b], &scene[half + 2..]].concat();
    let ended = [&scene[..half], &[0xff, 0xd9]].concat();
    for damaged in [&scene[..half], &false_marker, &ended] {
        let error = load(damaged).expect_err("damaged").to_string();
        assert!(error.contains("of its 120 rows are whole"), "{error}");
    }
    let lengthened = [&scene[..scene.len() - 2], &[0x55; 9], &[0xff, 0xd9]].concat();
    let error = load(&lengthened).expect_err("damaged").to_string();
    assert!(error.contains("out of place"), "{error}");
    // In a progressive picture the first scan alone is a complete, coarse picture.
    let coarse = SCENES[2];
    let marker = |pair: &[u8]| pair == [0xff, 0xc4];
    let scan = first_scan(coarse);
    let second = scan + coarse[scan..].windows(2).position(marker).expect("tables");
    let coarse = [&coarse[..second], &[0xff, 0xd9]].concat();
    let error = load(&coarse).expect_err("coarse").to_string();
    assert!(error.contains("before the last"), "{error}");
}

#[test]
fn lost_or_misplaced_rows_between_restart_markers_are_found() {
    for scene in [SCENES[1], SCENES[3]] {
        let is_marker = |at: &usize| scene[*at] == 0xff && matches!(scene[at + 1], 0xd0..=0xd7);
        let markers: Vec<usize> = (first_scan(scene)..scene.len() - 1).filter(is_marker).collect();
        let [a, b, c] = [markers[1], markers[2], markers[3]];
        let (before, one, two, behind) = (&scene[..a], &scene[a..b], &scene[b..c], &scene[c..]);
        assert_eq!([before, one, two, behind].concat(), scene);
        for (name, damaged) in [
            ("lost", vec![before, two, behind]),
            ("twice", vec![before, one, one, two, behind]),
            ("swapped", vec![before, two, one, behind]),
            ("shortened", vec![before, &one[..one.len() - 9], two, behind]),
            ("lengthened", vec![before, one, &[0x55; 9], two, behind]),
            ("emptied", vec![before, &one[..2], two, behind]),
        ] {
            let error = load(&damaged.concat()).expect_err(name).to_string();
            assert!(error.contains("of its 120 rows are whole"), "{name}: {error}");
        }
    }
}

#[test]
fn blocks_darker_than_black_or_brighter_than_white_are_found() {
    for value in [0_u8, 255] {
        let samples = vec![f32::from(value) / 255.0; 3 * 64 * 64];
        let image = Image::<Srgb>::from_planar(64, 64, samples);
        let mut jpeg = image.encode(crate::image::EncodeFormat::Jpeg(90)).expect("encoded");
        assert!(load(&jpeg).is_ok(), "{value}");
        // The quantisation step of each first luma coefficient.
        let marker = |pair: &[u8]| pair == [0xff, 0xdb];
        let step = jpeg.windows(2).position(marker).expect("steps") + 5;
        jpeg[step] *= 2;
        let error = load(&jpeg).expect_err("out of range").to_string();
        assert!(error.contains("the first 0 of its 64 rows"), "{value}: {error}");
    }
}

/// Share of values that differ by more than 12 levels.
fn off(a: &Image<Srgb>, b: &Image<Srgb>) -> f64 {
    let pairs = a.data().iter().zip(b.data());
    let off = pairs.filter(|(a, b)| (**a - **b).abs() > 12.0 / 255.0);
    off.count() as f64 / a.data().len() as f64
}

type Damage = (&'static str, f64, fn(&mut Vec<u8>, usize, &mut Pcg64));

/// Damage by disks, cables and programs, and the share of cases that spoil more than 3 % of the
/// picture that must be found. A single bit may change the brightness of everything after it, which
/// is found only where that is darker than black or brighter than white.
const DAMAGES: [Damage; 6] = [
    ("cut", 1.0, |bytes, at, _| bytes.truncate(at)),
    ("ended", 1.0, |bytes, at, _| {
        bytes.truncate(at);
        bytes.extend([0xff, 0xd9]);
    }),
    ("false marker", 1.0, |bytes, at, _| {
        bytes[at..at + 2].copy_from_slice(&[0xff, 0x9b]);
    }),
    ("zeroed", 0.8, |bytes, at, _| bytes[at..at + 48].fill(0)),
    ("left out", 0.8, |bytes, at, _| {
        drop(bytes.drain(at..at + 24));
    }),
    ("bits", 0.8, |bytes, at, random| {
        for _ in 0..8 {
            bytes[at + random.random_range(0..32_usize)] ^= 1 << random.random_range(0..8_u32);
        }
    }),
];

#[test]
fn damage_inside_a_scan_is_found_or_spoils_little() {
    for (number, scene) in SCENES.into_iter().enumerate() {
        let truth = load(scene).expect("read");
        let from = first_scan(scene);
        for (name, least, damage) in DAMAGES {
            let mut random = Pcg64::seed_from_u64(number as u64);
            let (mut found, mut missed) = (0, 0);
            for _ in 0..60 {
                let mut bytes = scene.to_vec();
                let at = random.random_range(from..scene.len() - 60);
                damage(&mut bytes, at, &mut random);
                match load(&bytes) {
                    Err(_) => found += 1,
                    Ok(image) => missed += u32::from(off(&image, &truth) > 0.03),
                }
            }
            let share = f64::from(found) / f64::from(found + missed);
            assert!(share >= least, "scene {number}, {name}: {found} found, {missed} missed");
        }
    }
}

#[test]
fn unsupported_kinds_are_named() {
    let frame = |at: usize, value: u8| {
        let mut scene = SCENES[0].to_vec();
        let marker = |pair: &[u8]| pair == [0xff, 0xc0];
        let start = scene.windows(2).position(marker).expect("a frame");
        scene[start + at] = value;
        load(&scene).expect_err("not read").to_string()
    };
    for (at, value, words) in [
        (1, 0xc9, "arithmetic coding"),
        (1, 0xc3, "lossless"),
        (4, 12, "more than 8 bits"),
        (6, 0, "tells its height behind"),
    ] {
        let message = frame(at, value);
        assert!(message.contains(words) && message.contains("save it as"), "{message}");
        assert!(!message.contains("decoder"), "{message}");
    }
}

#[test]
fn a_panorama_is_recognised_by_its_xmp_and_shape() {
    let xmp = |kind: &str| {
        let text = format!(
            "http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:Description \
             GPano:ProjectionType='{kind}'/></x:xmpmeta>"
        );
        let length = (text.len() as u16 + 2).to_be_bytes();
        [&[0xff, 0xe1], &length[..], text.as_bytes()].concat()
    };
    let picture = |width: usize, height: usize, kind: &str| {
        let ramp = (0..3 * width * height).map(|i| (i % width) as f32 / width as f32);
        let image = Image::<Srgb>::from_planar(width, height, ramp.collect());
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.jpg");
        image.save(&path).expect("written");
        let jpeg = fs::read(&path).expect("read");
        load(&[&jpeg[..2], &xmp(kind), &jpeg[2..]].concat())
    };
    let panorama = picture(200, 100, "equirectangular").expect_err("a panorama");
    assert!(panorama.to_string().contains("360 degrees"), "{panorama}");
    assert!(picture(200, 100, "rectilinear").is_ok());
    // A crop of one, with its XMP.
    assert!(picture(160, 120, "equirectangular").is_ok());
}
