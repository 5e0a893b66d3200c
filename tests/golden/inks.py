#!/usr/bin/env python3
"""CMYK photographs with a profile: tests/golden/photographs/cmyk.icc and inks*.jpg, and the colours that LittleCMS
gives them, which are constants of src/capture/image/colour/tests.rs.

Run once, with the result committed: `pip install pillow numpy`, `python tests/golden/inks.py`. The profile describes no
printer: inks are filters that gain 15 % in the middle and overlap on a paper of D50.
"""

import io
import itertools
import struct
from pathlib import Path

import numpy as np
from PIL import Image, ImageCms, features

from colour import profile

OUT = Path(__file__).parent / "photographs"
SIDE, ENTRIES, BLOCK = 5, 17, 16
# Shares of 255: skin, a dark green, a grey of black ink alone, and a blue.
PATCHES = [(20, 110, 140, 12), (190, 60, 200, 90), (0, 0, 0, 130), (210, 150, 10, 0)]
# XYZ of D50 that each ink lets through, as shares of the paper's.
INKS = np.array([[0.17, 0.25, 0.62], [0.36, 0.2, 0.22], [0.76, 0.8, 0.1], [0.025, 0.024, 0.022]])


def gain(v):
    return v + 0.6 * v * (1 - v)


def lab(xyz):
    root = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def table():
    """A lut16Type: curves of the inks, a grid, and a curve that undoes what the grid's lightness was bent by."""
    shares = np.array(list(itertools.product(np.linspace(0, 1, SIDE), repeat=4)))
    light = np.prod(1 - shares[:, :, None] * (1 - INKS), axis=1)
    # lut16Type: 65280 is L* of 100, and 32768 is 0 of a* and b*.
    coded = np.clip(lab(light) * [652.8, 256, 256] + [0, 32768, 32768], 0, 65535) / 65535
    coded[:, 0] **= 0.8
    steps = np.linspace(0, 1, ENTRIES)
    words = lambda v: np.round(65535 * np.clip(v, 0, 1)).astype(">u2").tobytes()
    identity = struct.pack(">9i", 65536, 0, 0, 0, 65536, 0, 0, 0, 65536)
    head = b"mft2\0\0\0\0" + bytes([4, 3, SIDE, 0]) + identity + struct.pack(">2H", ENTRIES, ENTRIES)
    return head + words(np.tile(gain(steps), 4)) + words(coded) + words(np.concatenate([steps**1.25, steps, steps]))


def ycck(inks):
    """What a JPEG of Adobe's transform 2 stores: JFIF's YCbCr of the first three inks, and the last upside down."""
    r, g, b, k = np.moveaxis(inks.astype(float), -1, 0)
    y = 0.299 * r + 0.587 * g + 0.114 * b
    stored = np.stack([y, 128 + (b - y) / 1.772, 128 + (r - y) / 1.402, 255 - k], -1)
    return np.round(stored).clip(0, 255).astype(np.uint8)


def main():
    # Of the class of printers, with one table for all intents.
    icc = profile("fled inks", b"prtrCMYKLab ", {b"A2B0": table()})
    (OUT / "cmyk.icc").write_bytes(icc)
    inks = np.array(PATCHES, np.uint8).repeat(BLOCK, 0)[None].repeat(BLOCK, 0)
    picture = Image.frombytes("CMYK", (BLOCK * len(PATCHES), BLOCK), inks.tobytes())
    # Pillow stores inks upside down, with Adobe's mark of transform 0.
    picture.save(OUT / "inks.jpg", quality=100, icc_profile=icc)
    content = io.BytesIO()
    stored = Image.frombytes("CMYK", picture.size, (255 - ycck(inks)).tobytes())
    stored.save(content, "jpeg", quality=100, icc_profile=icc)
    content = bytearray(content.getvalue())
    # The mark's last byte is the transform.
    content[content.index(b"Adobe") + 11] = 2
    (OUT / "inks-ycck.jpg").write_bytes(content)
    to_srgb = ImageCms.ImageCmsTransform(
        ImageCms.ImageCmsProfile(io.BytesIO(icc)),
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")),
        "CMYK",
        "RGB",
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
        flags=ImageCms.Flags.NOOPTIMIZE,
    )
    print(f"LittleCMS {features.version('littlecms2')}")
    for file in (picture, Image.open(OUT / "inks.jpg"), Image.open(OUT / "inks-ycck.jpg")):
        print([to_srgb.apply(file).getpixel((BLOCK * at + BLOCK // 2, BLOCK // 2)) for at in range(len(PATCHES))])


if __name__ == "__main__":
    main()
