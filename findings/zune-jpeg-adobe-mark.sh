#!/usr/bin/env bash
# zune-jpeg 0.5.15 (Rust): `decode_headers` calls an RGB JPEG with Adobe's mark CMYK, and `decode` calls it RGB.
#
# Adobe's mark (APP14) has one byte that says how components were converted. Its 0 means RGB for three components and
# CMYK for four. `decode_headers` goes by that byte alone; only `decode` looks at the number of components. Who chooses
# how to treat a picture after its header, as the two functions invite, sees inks where there are none. If the
# components are named R, G and B, as libjpeg names them, the header is read right.
#
# Output seen with Rust 1.95, zune-jpeg 0.5.15, Pillow 12.0.0:
#   Pillow reads (200, 100, 50)
#   3 components: CMYK by decode_headers, RGB by decode, which gives [200, 100, 50]
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pillow==12.0.0
venv/bin/python - <<'PYTHON'
import io
from PIL import Image

content = io.BytesIO()
Image.new("RGB", (16, 16), (200, 100, 50)).save(content, "jpeg", quality=95, keep_rgb=True)
jpeg = bytearray(content.getvalue())
assert jpeg[jpeg.index(b"Adobe") + 11] == 0
# The components' numbers in the frame and in the scan, which others number so.
frame, scan = jpeg.index(b"\xff\xc0"), jpeg.index(b"\xff\xda")
for n in range(3):
    jpeg[frame + 10 + 3 * n] = n + 1
    jpeg[scan + 5 + 2 * n] = n + 1
open("rgb.jpg", "wb").write(jpeg)
print("Pillow reads", Image.open(io.BytesIO(jpeg)).convert("RGB").getpixel((8, 8)))
PYTHON
cargo init --quiet --name check --vcs none
cargo add --quiet zune-jpeg@=0.5.15
cat >src/main.rs <<'RUST'
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;

fn main() {
    let jpeg = std::fs::read("rgb.jpg").unwrap();
    let mut decoder = JpegDecoder::new(ZCursor::new(&jpeg));
    decoder.decode_headers().unwrap();
    let components = decoder.info().unwrap().components;
    let by_header = format!("{:?}", decoder.input_colorspace().unwrap());
    let pixels = decoder.decode().unwrap();
    let decoded = format!("{:?}", decoder.input_colorspace().unwrap());
    let first = &pixels[..3];
    println!("{components} components: {by_header} by decode_headers, {decoded} by decode, which gives {first:?}");
    assert_eq!(components, 3);
    assert_eq!(by_header, "CMYK", "the header is read right");
    assert_eq!(decoded, "RGB", "decoding has changed");
}
RUST
cargo run --quiet
