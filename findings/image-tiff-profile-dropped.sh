#!/usr/bin/env bash
# image 0.25.10 (Rust): the ICC profile of a TIFF vanishes where it is large against the picture.
#
# `ImageReader` sets limits on its decoder. For TIFF it allows a tag's values the bytes of the decoded picture, and the
# `tiff` crate counts 32 bytes for each byte of a profile. A profile larger than a 32nd of the picture is dropped, and
# `icc_profile()` answers `Ok(None)`, not an error: a scan or thumbnail in Adobe RGB or with the table profile of a
# printer (half a megabyte) is taken for sRGB. `TiffDecoder::new` without limits returns the same profile.
#
# Output seen with Rust 1.95, image 0.25.10, tiff 0.11.3:
#   picture 64 x 64 (12288 bytes), profile 300 bytes: limits Some(300), none Some(300)
#   picture 64 x 64 (12288 bytes), profile 3000 bytes: limits None, none Some(3000)
#   picture 600 x 400 (720000 bytes), profile 3000 bytes: limits Some(3000), none Some(3000)
#   picture 600 x 400 (720000 bytes), profile 60000 bytes: limits None, none Some(60000)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cargo init --quiet --name check --vcs none
cargo add --quiet image@=0.25.10 --no-default-features --features tiff
cargo add --quiet tiff@=0.11.3
cat >src/main.rs <<'RUST'
use std::io::Cursor;

use image::codecs::tiff::TiffDecoder;
use image::{ImageDecoder, ImageFormat, ImageReader};
use tiff::encoder::{TiffEncoder, colortype::RGB8};
use tiff::tags::Tag;

fn written(width: u32, height: u32, profile: usize) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = encoder.new_image::<RGB8>(width, height).unwrap();
    image.encoder().write_tag(Tag::IccProfile, &vec![0_u8; profile][..]).unwrap();
    image.write_data(&vec![128; (3 * width * height) as usize]).unwrap();
    bytes.into_inner()
}

fn main() {
    for (width, height, profile, is_kept) in
        [(64, 64, 300, true), (64, 64, 3_000, false), (600, 400, 3_000, true), (600, 400, 60_000, false)]
    {
        let bytes = written(width, height, profile);
        let reader = ImageReader::with_format(Cursor::new(&bytes), ImageFormat::Tiff);
        let length = |mut decoder: Box<dyn ImageDecoder + '_>| decoder.icc_profile().unwrap().map(|icc| icc.len());
        let limited = length(Box::new(reader.into_decoder().unwrap()));
        let free = length(Box::new(TiffDecoder::new(Cursor::new(&bytes)).unwrap()));
        let size = 3 * width * height;
        println!(
            "picture {width} x {height} ({size} bytes), profile {profile} bytes: limits {limited:?}, none {free:?}"
        );
        assert_eq!(free, Some(profile), "a decoder without limits no longer returns the profile");
        assert_eq!(limited.is_some(), is_kept, "what the limits leave has changed");
    }
}
RUST
cargo run --quiet
