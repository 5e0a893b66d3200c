#!/usr/bin/env python3
"""Makes the small photographs that the reader's golden tests look at.

Run once, with the result committed: `pip install pillow tifffile imagecodecs numpy`, Debian's libheif-examples, then
`python tests/golden/photographs.py`. Each is 2 x 2 blocks of 16 px in the colours below, but for
`scene*.jpg`, in which something is to be seen in every block that a JPEG is coded in.
"""

import subprocess
from pathlib import Path

import numpy
import tifffile
from PIL import Image

COLOURS = [(200, 40, 40), (40, 200, 40), (40, 40, 200), (230, 230, 60)]
OUT = Path(__file__).parent / "photographs"
ORIENTATION = 0x0112


def blocks() -> numpy.ndarray:
    picture = numpy.zeros((32, 32, 3), numpy.uint8)
    for index, colour in enumerate(COLOURS):
        y, x = 16 * (index // 2), 16 * (index % 2)
        picture[y : y + 16, x : x + 16] = colour
    return picture


def scene(width: int = 160, height: int = 120) -> numpy.ndarray:
    y, x = numpy.mgrid[0:height, 0:width].astype(float)
    light = 70 + 0.5 * x + 0.3 * y + 12 * numpy.sin(x / 5) * numpy.cos(y / 7)
    picture = numpy.stack([light, 0.8 * light + 10, 0.6 * light + 30], axis=2)
    for index in range(9):
        far = numpy.hypot(x - (17 + 53 * index) % width, y - (11 + 37 * index) % height)
        picture[far < 9 + index] = [(40 * index) % 200 + 30, (70 * index) % 200 + 30, (90 * index) % 200 + 30]
    return numpy.clip(picture, 0, 255).astype(numpy.uint8)


def main() -> None:
    OUT.mkdir(exist_ok=True)
    rgb = blocks()
    picture = Image.fromarray(rgb)
    picture.quantize(4).save(OUT / "palette.png")
    picture.save(OUT / "progressive.jpg", quality=95, progressive=True, subsampling=0)
    # Pillow writes CMYK JPEG as Adobe does: inverted, with its APP14 segment.
    picture.convert("CMYK").save(OUT / "cmyk.jpg", quality=95)
    shapes = Image.fromarray(scene())
    shapes.save(OUT / "scene.jpg", quality=85)
    shapes.save(OUT / "scene-restart.jpg", quality=85, restart_marker_rows=1)
    shapes.save(OUT / "scene-progressive.jpg", quality=85, progressive=True)
    # A table, say, that reaches from the middle to the right border and begins with a row of blocks.
    table = scene()
    table[48:, 72:] = numpy.clip(table[48:, 72:].astype(int) + 40, 0, 255)
    table = Image.fromarray(table)
    table.save(OUT / "scene-edge.jpg", quality=85, subsampling=0, restart_marker_rows=1)
    picture.save(OUT / "lossless.webp", lossless=True)
    picture.convert("CMYK").save(OUT / "cmyk.tif")
    lossless = ["heif-enc", "--lossless", "-p", "chroma=444", OUT / "palette.png", "-o", OUT / "lossless.heic"]
    subprocess.run(lossless, check=True)
    tifffile.imwrite(OUT / "deep.tif", rgb.astype(numpy.uint16) * 257, photometric="rgb", compression="zlib")
    # Stored a quarter turn to the left, with the orientation (6) that turns it back.
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    picture.rotate(90, expand=True).save(OUT / "turned.jpg", quality=95, subsampling=0, exif=exif)


if __name__ == "__main__":
    main()
