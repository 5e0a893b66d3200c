#!/usr/bin/env bash
# moxcms 0.8.1 (Rust): CMYK is converted through a coarse grid of its own, with inks rounded to 8 bits.
#
# A transform from CMYK to RGB tabulates the profile anew at 17 values of each ink, as encoded and clipped RGB, and
# looks up a place in that grid by 8 bits of each ink, for pictures of 16 bits, too: inks from 8,192 to 8,319 of 65,535
# all give one colour. Between the nodes colours differ from LittleCMS's by up to 20 levels of 255, most where a channel
# is dark, even if the profile's own grid is coarser than 17.
#
# Output seen with Rust 1.95, moxcms 0.8.1, Pillow 12.0.0:
#   LittleCMS 2.17
#   16 bits: 128 inks from 8192 to 8319 have 1 colours
#   levels of 255 from LittleCMS at most: 20.0 where a channel is below 40, 9.9 elsewhere
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pillow==12.0.0
cat >make.py <<'PYTHON'
"""A CMYK profile of filters over paper, inks, and the colours that LittleCMS gives them."""
import io, itertools, random, struct
from PIL import Image, ImageCms, features

SIDE = 9
WHITE = (0.9642, 1.0, 0.8249)
INKS = [(0.17, 0.25, 0.62), (0.36, 0.2, 0.22), (0.76, 0.8, 0.1), (0.025, 0.024, 0.022)]

def lab(inks):
    roots = []
    for axis in range(3):
        share = 1.0
        for ink, through in zip(inks, INKS):
            share *= 1 - ink * (1 - through[axis])
        roots.append(share ** (1 / 3) if share > (6 / 29) ** 3 else share / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = roots
    return (116 * y - 16) * 652.8, 500 * (x - y) * 256 + 32768, 200 * (y - z) * 256 + 32768

steps = [i / (SIDE - 1) for i in range(SIDE)]
words = lambda values: b"".join(struct.pack(">H", min(65535, max(0, round(v)))) for v in values)
curve = words([0, 65535])
table = b"mft2\0\0\0\0" + bytes([4, 3, SIDE, 0]) + struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 65536)
table += struct.pack(">2H", 2, 2) + 4 * curve
table += b"".join(words(lab(inks)) for inks in itertools.product(steps, repeat=4)) + 3 * curve
text = b"inks\0"
white = struct.pack(">3i", *(round(65536 * v) for v in WHITE))
tags = [(b"desc", b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(78)),
        (b"wtpt", b"XYZ \0\0\0\0" + white), (b"cprt", b"text\0\0\0\0none\0"), (b"A2B0", table), (b"A2B1", table)]
directory, body, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
for name, content in tags:
    directory += name + struct.pack(">II", start + len(body), len(content))
    body += content + bytes(-len(content) % 4)
head = struct.pack(">I4xI", start + len(body), 0x02400000) + b"prtrCMYKLab " + struct.pack(">6H", 2026, 1, 1, 0, 0, 0)
icc = (head + b"acsp" + bytes(28) + white).ljust(128, b"\0") + directory + body
open("cmyk.icc", "wb").write(icc)

random.seed(1)
inks = bytes(random.randrange(256) for _ in range(4 * 4096))
open("inks", "wb").write(inks)
profiles = [ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB"))]
flags = ImageCms.Flags.NOOPTIMIZE
to_srgb = ImageCms.ImageCmsTransform(*profiles, "CMYK", "RGB", ImageCms.Intent.RELATIVE_COLORIMETRIC, flags=flags)
open("expected", "wb").write(to_srgb.apply(Image.frombytes("CMYK", (4096, 1), inks)).tobytes())
print("LittleCMS", features.version("littlecms2"))
PYTHON
venv/bin/python make.py
cargo init --quiet --name check --vcs none
cargo add --quiet moxcms@=0.8.1
cat >src/main.rs <<'RUST'
use moxcms::{ColorProfile, Layout, RenderingIntent, TransformOptions};

fn main() {
    let profile = ColorProfile::new_from_slice(&std::fs::read("cmyk.icc").unwrap()).unwrap();
    let srgb = ColorProfile::new_srgb();
    let options = TransformOptions { rendering_intent: RenderingIntent::RelativeColorimetric, ..Default::default() };
    let deep = profile.create_transform_16bit(Layout::Rgba, &srgb, Layout::Rgb, options).unwrap();
    let convert = |inks: &[u16]| {
        let mut colours = vec![0_u16; inks.len() / 4 * 3];
        deep.transform(inks, &mut colours).unwrap();
        colours
    };
    let ramp: Vec<u16> = (8192..8320).flat_map(|cyan| [cyan, 20_000, 30_000, 5_000]).collect();
    let mut colours: Vec<[u16; 3]> = convert(&ramp).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
    colours.dedup();
    println!("16 bits: 128 inks from 8192 to 8319 have {} colours", colours.len());

    let inks: Vec<u16> = std::fs::read("inks").unwrap().iter().map(|v| 257 * u16::from(*v)).collect();
    let expected = std::fs::read("expected").unwrap();
    let far: Vec<f64> =
        convert(&inks).iter().zip(&expected).map(|(v, e)| (f64::from(*v) / 257.0 - f64::from(*e)).abs()).collect();
    let most = |is_meant: fn(&[u8]) -> bool| {
        let meant = far.chunks_exact(3).zip(expected.chunks_exact(3)).filter(|(_, colour)| is_meant(colour));
        meant.flat_map(|(far, _)| far).fold(0.0_f64, |most, far| most.max(*far))
    };
    let dark = most(|colour| colour.iter().any(|v| *v < 40));
    let others = most(|colour| colour.iter().all(|v| *v >= 40));
    println!(
        "levels of 255 from LittleCMS at most: {dark:.1} where a channel is below 40, {others:.1} elsewhere"
    );
    assert!(colours.len() == 1, "inks are no longer rounded to 8 bits");
    assert!(dark > 10.0, "dark colours have become right");
    assert!(others < dark / 2.0, "other colours have become worse");
}
RUST
cargo run --quiet
