#!/usr/bin/env python3
"""Makes the small photographs that the reader's golden tests look at.

Run once, with the result committed: `pip install pillow pillow-heif==1.1.1 tifffile imagecodecs numpy`, Debian's
libheif-examples, then `python tests/golden/photographs.py`. Each is 2 x 2 blocks of 16 px in the colours below, but for
`scene*.jpg`, in which something is to be seen in every block that a JPEG is coded in, and `pq.heic` and `hlg.heic`,
which have the light of HDR below. Debian's ffmpeg says what that becomes, with the filters that videos pass through.
"""

import subprocess
from pathlib import Path

import numpy
import pillow_heif
import tifffile
from PIL import Image

COLOURS = [(200, 40, 40), (40, 200, 40), (40, 40, 200), (230, 230, 60)]
# Light in the primaries of BT.2020, nits: a dark and a bright grey, an orange, and the brightest white.
HDR = [(10, 10, 10), (203, 203, 203), (120, 40, 10), (1000, 1000, 1000)]
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


def pq(nits: numpy.ndarray) -> numpy.ndarray:
    power = (nits / 10_000) ** (2610 / 16_384)
    return ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)


def hlg(nits: numpy.ndarray) -> numpy.ndarray:
    shown = nits / 1000
    luminance = shown @ [0.2627, 0.6780, 0.0593]
    scene = shown * luminance[:, None] ** (1 / 1.2 - 1)
    a = 0.17883277
    bright = a * numpy.log(numpy.maximum(12 * scene - (1 - 4 * a), 1e-9)) + 0.55991073
    return numpy.where(scene <= 1 / 12, numpy.sqrt(3 * scene), bright)


def larger_range(name: str, code: int, values: numpy.ndarray) -> numpy.ndarray:
    """Writes 10 bits without loss."""
    levels = numpy.round(values * 1023).astype(numpy.uint16)
    picture = levels[numpy.kron([[0, 1], [2, 3]], numpy.ones((16, 16), int))]
    heic = pillow_heif.from_bytes(mode="RGB;16", size=(32, 32), data=(picture << 6).tobytes())
    coding = {"color_primaries": 9, "transfer_characteristics": code, "matrix_coefficients": 0, "full_range_flag": 1}
    heic.save(OUT / f"{name}.heic", quality=-1, chroma=444, **coding)
    return picture


def print_srgb(picture: numpy.ndarray) -> None:
    """Prints what the filters for videos make of PQ. With HLG, zscale bends each channel by itself."""
    filters = (
        "setparams=range=pc:color_primaries=bt2020:color_trc=smpte2084:colorspace=gbr,"
        "zscale=t=linear:npl=203,format=gbrpf32le,zscale=p=bt709,"
        f"tonemap=mobius:desat=0:peak={1000 / 203},zscale=t=iec61966-2-1:m=gbr:r=full,format=gbrp16le"
    )
    raw = ["ffmpeg", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "gbrp10le", "-s", "32x32", "-i", "-"]
    planes = picture.transpose(2, 0, 1)[[1, 2, 0]].tobytes()
    made = subprocess.run([*raw, "-vf", filters, "-f", "rawvideo", "-"], input=planes, capture_output=True, check=True)
    green, blue, red = numpy.frombuffer(made.stdout, "<u2").reshape(3, 32, 32)
    for y, x in [(8, 8), (8, 24), (24, 8), (24, 24)]:
        print([round(float(plane[y, x]) / 65_535, 4) for plane in (red, green, blue)])


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
    light = numpy.array(HDR, float)
    print_srgb(larger_range("pq", 16, pq(light)))
    larger_range("hlg", 18, hlg(light))
    tifffile.imwrite(OUT / "deep.tif", rgb.astype(numpy.uint16) * 257, photometric="rgb", compression="zlib")
    # Stored a quarter turn to the left, with the orientation (6) that turns it back.
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    picture.rotate(90, expand=True).save(OUT / "turned.jpg", quality=95, subsampling=0, exif=exif)


if __name__ == "__main__":
    main()
