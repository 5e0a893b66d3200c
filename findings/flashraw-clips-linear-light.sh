#!/usr/bin/env bash
# flashraw 0.1.1 (Rust): "linear, not clipped" outputs of a raw file are clipped at black and at white.
#
# The documentation of `OutputFormat::LinearRgbF32` says "values are not clipped". Samples are clamped to 0..=1 after
# white balance, before the camera's matrix, and `NormalizedF32` is cut at 0. Noise around black then has a mean above
# it: a black patch whose samples scatter by 20 codes on both sides of the black level has light 0.0007 in place of 0,
# which a gain of 30 makes a grey. `RawU16` has the samples as they are.
#
# Output seen with Rust 1.95, flashraw 0.1.1, a Bayer DNG of 64 x 64 with black 512, white 15360, half of the samples 20
# codes above black and half 20 codes below:
#   RawU16: mean 512.000, least 492
#   NormalizedF32: mean 0.000673, least 0.000000
#   LinearRgbF32: mean 0.000673, least 0.000000
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cargo init --quiet --name check --vcs none
cargo add --quiet flashraw@=0.1.1 --no-default-features
cat >src/main.rs <<'RUST'
use flashraw::{DecodeOptions, Demosaic, FlashRaw, OutputFormat, RawPixelData};

const SIDE: u32 = 64;
const BLACK: u16 = 512;
const WHITE: u16 = 15_360;

/// A DNG of one strip; values longer than four bytes follow the directory.
fn dng() -> Vec<u8> {
    let short = |values: &[u16]| (3_u16, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect());
    let long = |values: &[u32]| (4_u16, values.len() as u32, values.iter().flat_map(|v| v.to_le_bytes()).collect());
    let ratio = |kind: u16, values: &[i32]| {
        let bytes: Vec<u8> = values.iter().flat_map(|v| [*v, 10_000]).flat_map(i32::to_le_bytes).collect();
        (kind, values.len() as u32, bytes)
    };
    let text = |value: &str| (2_u16, value.len() as u32 + 1, [value.as_bytes(), &[0]].concat());
    // XYZ to linear sRGB: the camera sees what sRGB means.
    let matrix = [32_406, -15_372, -4_986, -9_689, 18_758, 415, 557, -2_040, 10_570];
    let samples: Vec<u16> = (0..SIDE * SIDE)
        .map(|i| if (i % SIDE / 2 + i / SIDE / 2) % 2 == 0 { BLACK + 20 } else { BLACK - 20 })
        .collect();
    let mut tags: Vec<(u16, (u16, u32, Vec<u8>))> = vec![
        (254, long(&[0])), (256, long(&[SIDE])), (257, long(&[SIDE])), (258, short(&[16])), (259, short(&[1])),
        (262, short(&[32_803])), (271, text("Made")), (272, text("Up")), (273, long(&[0])), (277, short(&[1])),
        (278, long(&[SIDE])), (279, long(&[2 * SIDE * SIDE])), (33_421, short(&[2, 2])),
        (33_422, (1, 4, vec![0, 1, 1, 2])), (50_706, (1, 4, vec![1, 4, 0, 0])), (50_708, text("Made Up")),
        (50_714, long(&[BLACK.into()])), (50_717, long(&[WHITE.into()])), (50_721, ratio(10, &matrix)),
        (50_728, ratio(5, &[10_000; 3])), (50_778, short(&[21])),
    ];
    let directory = 8 + 2 + 12 * tags.len() + 4;
    let tail: usize = tags.iter().filter(|(_, tag)| tag.2.len() > 4).map(|(_, tag)| tag.2.len().next_multiple_of(2)).sum();
    tags.iter_mut().find(|tag| tag.0 == 273).unwrap().1 = long(&[(directory + tail) as u32]);
    let (mut bytes, mut behind) = (b"II*\0\x08\0\0\0".to_vec(), Vec::new());
    bytes.extend((tags.len() as u16).to_le_bytes());
    for (tag, (kind, count, mut value)) in tags {
        bytes.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        bytes.extend(count.to_le_bytes());
        if value.len() > 4 {
            bytes.extend(((directory + behind.len()) as u32).to_le_bytes());
            value.resize(value.len().next_multiple_of(2), 0);
            behind.extend(value);
        } else {
            value.resize(4, 0);
            bytes.extend(value);
        }
    }
    bytes.extend([0; 4]);
    bytes.extend(behind);
    bytes.extend(samples.iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

fn decoded(output: OutputFormat) -> (f64, f64) {
    let file = FlashRaw::open(dng()).unwrap();
    let options = DecodeOptions { output, demosaic: Demosaic::HalfSize, ..DecodeOptions::default() };
    let values: Vec<f64> = match file.decode(options).unwrap().data {
        RawPixelData::U16(values) => values.into_iter().map(f64::from).collect(),
        RawPixelData::F32(values) => values.into_iter().map(f64::from).collect(),
        _ => panic!("another kind of sample"),
    };
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    (values.iter().sum::<f64>() / values.len() as f64, least)
}

fn main() {
    let (mean, least) = decoded(OutputFormat::RawU16);
    println!("RawU16: mean {mean:.3}, least {least}");
    assert_eq!((mean, least), (512.0, 492.0), "the samples are read otherwise");
    for output in [OutputFormat::NormalizedF32, OutputFormat::LinearRgbF32] {
        let (mean, least) = decoded(output);
        println!("{output:?}: mean {mean:.6}, least {least:.6}");
        assert!(mean > 6e-4 && least > -1e-6, "values below black are kept now");
    }
}
RUST
cargo run --quiet
