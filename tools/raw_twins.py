#!/usr/bin/env python3
"""Writes the same photons three ways: as raw files, as a camera's JPEGs, and as light without noise.

    tools/raw_twins.py SHARP OUT --dark 30

SHARP is a folder with images/ and sparse/ (COLMAP, text). Every --every-th photograph is enlarged, darkened and counted
in electrons on a Bayer sensor; OUT/raw has 12-bit DNGs, OUT/jpeg what a camera makes of them (black cut, denoised,
sharpened, tones mapped locally, 8 bits, 4:2:0), OUT/ideal 16-bit PNGs of the light itself. All have the poses of SHARP;
`fled eval RUN --truth SHARP` judges runs on them. Needs numpy, scipy and pillow.
"""

import argparse
import struct
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import convolve, gaussian_filter, median_filter

BLACK, WHITE = 256, 4095
ELECTRONS = 2.0  # a code
READ_NOISE = 3.0  # electrons
# Linear sRGB to the camera's balanced colours; the camera's response to white.
CAMERA = np.array([[0.7, 0.25, 0.05], [0.2, 0.7, 0.1], [0.05, 0.3, 0.65]])
NEUTRAL = np.array([0.5, 1.0, 0.7])
XYZ_OF_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def to_light(v):
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def to_srgb(v):
    v = np.clip(v, 0, 1)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * v ** (1 / 2.4) - 0.055)


def mosaic(shape):
    """The channel of each sample: RGGB."""
    colours = np.ones(shape, int)
    colours[::2, ::2], colours[1::2, 1::2] = 0, 2
    return colours


def exposed(light, generator):
    """Codes of the sensor for light (white at 1)."""
    balanced = light @ CAMERA.T * NEUTRAL
    samples = np.take_along_axis(balanced, mosaic(light.shape[:2])[..., None], 2)[..., 0]
    electrons = samples * (WHITE - BLACK) * ELECTRONS
    electrons = generator.poisson(np.maximum(electrons, 0)) + READ_NOISE * generator.normal(size=electrons.shape)
    return np.clip(np.round(electrons / ELECTRONS + BLACK), 0, WHITE).astype(np.uint16)


def dng(codes, seconds):
    """A DNG: tags in ascending order, values longer than 4 bytes behind them, samples last."""
    height, width = codes.shape
    matrix = np.diag(NEUTRAL) @ CAMERA @ np.linalg.inv(XYZ_OF_SRGB)
    # Of normalised values: the variance of x is S x + O.
    scale = 1 / (ELECTRONS * (WHITE - BLACK))
    noise = [scale, (READ_NOISE * scale) ** 2]
    rational = lambda values: b"".join(struct.pack("<ii", round(1e6 * v), 1_000_000) for v in values)
    short = lambda *values: (3, len(values), struct.pack(f"<{len(values)}H", *values))
    long = lambda *values: (4, len(values), struct.pack(f"<{len(values)}I", *values))
    text = lambda value: (2, len(value) + 1, value.encode() + b"\0")
    tags = {
        254: long(0), 256: long(width), 257: long(height), 258: short(16), 259: short(1), 262: short(32803),
        271: text("Fled"), 272: text("Twins"), 273: long(0), 274: short(1), 277: short(1), 278: long(height),
        279: long(2 * codes.size), 284: short(1), 33421: short(2, 2), 33422: (1, 4, bytes([0, 1, 1, 2])),
        33434: (5, 1, rational([seconds])), 34855: short(1600), 50706: (1, 4, bytes([1, 4, 0, 0])),
        50708: text("Fled Twins"), 50714: long(BLACK), 50717: long(WHITE), 50721: (10, 9, rational(matrix.ravel())),
        50728: (5, 3, rational(NEUTRAL)), 50778: short(21), 51041: (12, 2, struct.pack("<2d", *noise)),
    }
    start = 8 + 2 + 12 * len(tags) + 4
    tail_length = sum(len(v) + len(v) % 2 for _, _, v in tags.values() if len(v) > 4)
    tags[273] = long(start + tail_length)
    head, tail = [b"II*\0\x08\0\0\0", struct.pack("<H", len(tags))], b""
    for tag, (kind, count, value) in sorted(tags.items()):
        if len(value) > 4:
            head.append(struct.pack("<HHII", tag, kind, count, start + len(tail)))
            tail += value + b"\0" * (len(value) % 2)
        else:
            head.append(struct.pack("<HHI", tag, kind, count) + value.ljust(4, b"\0"))
    return b"".join(head) + b"\0\0\0\0" + tail + codes.astype("<u2").tobytes()


def camera_jpeg(codes):
    """What a camera makes of the codes, 8 bits."""
    samples = np.maximum(codes.astype(float) - BLACK, 0) / (WHITE - BLACK)
    colours = mosaic(codes.shape)
    kernel = np.array([[0.25, 0.5, 0.25], [0.5, 1, 0.5], [0.25, 0.5, 0.25]])
    of = lambda c: convolve(samples * (colours == c), kernel) / convolve((colours == c) * 1.0, kernel)
    rgb = np.stack([of(0), of(1), of(2)], 2) / NEUTRAL @ np.linalg.inv(CAMERA).T
    rgb = np.clip(rgb, 0, 1)
    luma = rgb @ [0.2126, 0.7152, 0.0722]
    chroma = np.stack([median_filter(rgb[..., c] - luma, 5) for c in range(3)], 2)
    smooth = gaussian_filter(luma, 1.0)
    luma = smooth + 0.5 * (smooth - gaussian_filter(smooth, 2.0))
    local = (gaussian_filter(luma, luma.shape[0] / 12) + 1e-4) / (luma.mean() + 1e-4)
    light = np.clip(luma[..., None] + chroma, 0, 1) * (local**-0.15)[..., None]
    return (255 * to_srgb(light) + 0.5).astype(np.uint8)


def png16(light):
    """A 16-bit RGB PNG as sRGB (Pillow writes none)."""
    import zlib

    values = np.round(65535 * to_srgb(light)).astype(">u2")
    height, width = values.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in values)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b"")


def write_poses(sharp, out, names, extension, scale):
    (out / "sparse").mkdir(parents=True, exist_ok=True)
    cameras = []
    for line in (sharp / "sparse" / "cameras.txt").read_text().splitlines():
        words = line.split()
        if line.startswith("#") or not words:
            continue
        lengths = {"SIMPLE_PINHOLE": 3, "SIMPLE_RADIAL": 3, "RADIAL": 3}.get(words[1], 4)
        scaled = [str(scale * int(v)) for v in words[2:4]] + [str(scale * float(v)) for v in words[4 : 4 + lengths]]
        cameras.append(" ".join(words[:2] + scaled + words[4 + lengths :]))
    (out / "sparse" / "cameras.txt").write_text("\n".join(cameras) + "\n")
    kept = []
    for line in (sharp / "sparse" / "images.txt").read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#") and Path(words[9]).stem in names:
            kept.append(" ".join(words[:9] + [Path(words[9]).stem + extension]) + "\n\n")
    (out / "sparse" / "images.txt").write_text("".join(kept))
    points = (sharp / "sparse" / "points3D.txt").read_text().splitlines()
    # The tracks name points of images that are left out.
    (out / "sparse" / "points3D.txt").write_text("".join(" ".join(p.split()[:8]) + "\n" for p in points if p[:1] != "#"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sharp", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--dark", type=float, default=30.0, help="exposures are this much too short")
    parser.add_argument("--scale", type=int, default=3, help="samples of the sensor a pixel of the sharp pictures")
    parser.add_argument("--every", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    kinds = {"raw": ".dng", "jpeg": ".jpg", "ideal": ".png"}
    for kind in kinds:
        (args.out / kind / "images").mkdir(parents=True, exist_ok=True)
    files = sorted((args.sharp / "images").iterdir())[:: args.every]
    for index, file in enumerate(files):
        picture = Image.open(file).convert("RGB")
        picture = picture.resize((args.scale * picture.width, args.scale * picture.height), Image.BICUBIC)
        light = to_light(np.asarray(picture) / 255.0) / args.dark
        codes = exposed(light, np.random.default_rng([args.seed, index]))
        path = lambda kind: args.out / kind / "images" / (file.stem + kinds[kind])
        path("raw").write_bytes(dng(codes, 1 / args.dark))
        Image.fromarray(camera_jpeg(codes)).save(path("jpeg"), quality=92, subsampling=2)
        path("ideal").write_bytes(png16(light))
    names = {file.stem for file in files}
    for kind, extension in kinds.items():
        write_poses(args.sharp, args.out / kind, names, extension, args.scale)


if __name__ == "__main__":
    main()
