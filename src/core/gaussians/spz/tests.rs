use std::io::Read;

use flate2::read::GzDecoder;
use glam::DVec3;

use super::super::fixtures::{differences, scattered};
use super::*;
use crate::camera::normalisation::Normalisation;

type Version = fn(&Scene, &mut dyn Write) -> io::Result<()>;

fn written(gaussians: &Gaussians, version: Version) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let scene = Scene { gaussians: gaussians.clone(), normalisation: Normalisation::default() };
    version(&scene, &mut bytes).map(|()| bytes)
}

/// The streams of a file, one after the other behind the first 16 bytes.
fn unpacked(bytes: &[u8]) -> Vec<u8> {
    let word = |at: usize| u32::from_le_bytes(bytes[at..][..4].try_into().expect("four")) as usize;
    let mut all = Vec::new();
    if !bytes.starts_with(MAGIC) {
        GzDecoder::new(bytes).read_to_end(&mut all).expect("gzip");
        return all;
    }
    all.extend(&bytes[..16]);
    let (streams, table) = (usize::from(bytes[15]), word(16));
    let mut at = table + 16 * streams;
    for stream in 0..streams {
        let (packed, length) = (word(table + 16 * stream), word(table + 16 * stream + 8));
        let stream = zstd::bulk::decompress(&bytes[at..at + packed], length).expect("Zstandard");
        assert_eq!(stream.len(), length);
        all.extend(stream);
        at += packed;
    }
    assert_eq!(at, bytes.len());
    all
}

/// Reads a file of either version: both hold the same streams.
fn read(bytes: &[u8]) -> Gaussians {
    let mut bytes = unpacked(bytes);
    (bytes[4], bytes[15]) = (3, 0);
    unpack(&bytes).expect("a whole file")
}

#[test]
fn a_round_trip_differs_by_at_most_half_a_step() {
    for (degree, version) in
        (0..=3).flat_map(|d| [(d, write_version_3 as Version), (d, write_version_4)])
    {
        let mut scene = scattered(500, 8.0, degree);
        scene.sh.iter_mut().for_each(|value| *value = value.clamp(-0.98, 0.9));
        let back = read(&written(&scene, version).expect("written"));
        let found = differences(&scene, &back);
        // 20 bits after the point; half a step of scales, colours and opacities; a step of a
        // rotation, and half a bucket.
        let harmonics = if degree == 1 { 4.0 / 128.0 } else { 8.0 / 128.0 };
        let bounds =
            [2_f32.powi(-21), 1.0 / 32.0, 0.282 / 0.15 / 510.0, 1.0 / 510.0, 0.006, harmonics];
        for (found, bound) in found.iter().zip(bounds) {
            assert!(*found <= bound * 1.01, "degree {degree}: {found} > {bound}");
        }
    }
}

#[test]
fn both_versions_hold_the_same_numbers_under_their_own_header() {
    let scene = scattered(300, 2.0, 2);
    let (three, four) = (written(&scene, write_version_3), written(&scene, write_version_4));
    let (three, four) = (unpacked(&three.expect("written")), four.expect("written"));
    assert_eq!(three[..16], *b"NGSP\x03\0\0\0\x2c\x01\0\0\x02\x16\0\0");
    assert_eq!(four[..20], *b"NGSP\x04\0\0\0\x2c\x01\0\0\x02\x16\0\x06\x20\0\0\0");
    assert_eq!(three[16..], unpacked(&four)[16..]);
    assert_eq!(read(&written(&Gaussians::default(), write_version_4).expect("empty")).len(), 0);
}

#[test]
fn the_point_moves_with_the_largest_coordinate() {
    let mut scene = scattered(2, 0.1, 0);
    for (largest, bits) in [(0.4, 24), (0.9, 23), (1.5, 22), (-3000.0, 11), (8e6, 0)] {
        scene.means[1][2] = largest;
        let file = written(&scene, write_version_3).expect("written");
        assert_eq!(unpacked(&file)[13], bits, "{largest}");
        assert!((read(&file).means[1][2] - largest).abs() <= 0.5_f32.powi(1 + i32::from(bits)));
    }
    scene.means[1][2] = 9e6;
    let error = written(&scene, write_version_3).expect_err("too far");
    assert!(error.to_string().contains("9000000"), "{error}");
}

#[test]
fn a_scene_in_a_unit_beyond_the_scales_is_refused_and_thin_gaussians_are_not() {
    let mut scene = scattered(5, 1.0, 0);
    scene.log_scales[2][0] = -20.0;
    assert_eq!(read(&written(&scene, write_version_4).expect("thin")).log_scales[2][0], -10.0);
    for by in [8.0, -9.5] {
        let other = scene.moved(f64::exp(by), DVec3::ZERO);
        let error = written(&other, write_version_3).expect_err("beyond");
        assert!(error.to_string().contains("another format"), "{error}");
    }
}

#[test]
fn a_file_that_is_cut_or_of_another_version_is_refused() {
    let scene = scattered(5, 1.0, 1);
    let file = written(&scene, write_version_3).expect("written");
    assert_eq!(read_version_3(&file).expect("whole"), read(&file));
    let refused = |bytes: &[u8]| {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(bytes).expect("gzip");
        let error = read_version_3(&gzip.finish().expect("gzip")).expect_err("refused");
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
    };
    let whole = unpacked(&file);
    for length in 0..whole.len() {
        refused(&whole[..length]);
    }
    refused(&[&whole[..], &[0]].concat());
    for (at, byte) in [(0, b'P'), (4, 2), (12, 4), (13, 25)] {
        let mut other = whole.clone();
        other[at] = byte;
        refused(&other);
    }
    assert!(read_version_3(&whole).is_err());
}
