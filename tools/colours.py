#!/usr/bin/env python3
"""Holds the colours that fled reads against LittleCMS and LibRaw.

    make test-colours

Writes one chart of colours as JPEG, PNG, TIFF, WebP and HEIC with profiles of several spaces, and as Bayer DNGs of three
exposures; `fled prepare` reads them. LittleCMS (in Pillow) says what the pictures mean in sRGB, LibRaw (rawpy) what the
DNGs do. Exits with 1 where a patch differs by more than its format's tolerance, levels of 255.
"""

import argparse
import io
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pillow_heif
import rawpy
from PIL import Image, ImageCms, features

import raw_twins

sys.path.append(str(Path(__file__).resolve().parent.parent / "tests" / "golden"))
from colour import SPACES, fixed, profile, to_pcs

ROWS, COLUMNS, PATCH = 8, 12, 32
# Levels of 255.
TOLERANCES = {"png": 1.0, "tif": 1.0, "webp": 1.0, "jpg": 2.0, "heic": 2.0, "dng": 2.0}
# Levels below which a channel of a raw file is not compared.
DIM = 30


def profile_of(name):
    """An ICC profile with curves and primaries."""
    primaries, white, light_of = SPACES[name]
    matrix = to_pcs(primaries, white)
    light = light_of(np.linspace(0, 1, 4096))
    curve = b"curv\0\0\0\0" + struct.pack(">I", 4096) + np.round(65535 * light).astype(">u2").tobytes()
    columns = {tag: b"XYZ \0\0\0\0" + fixed(matrix[:, c]) for c, tag in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))}
    return profile(f"fled {name}", b"mntrRGB XYZ ", {**columns, **{tag: curve for tag in (b"rTRC", b"gTRC", b"bTRC")}})


def chart(seed):
    """Colours of which no two files are alike, an upper row of greys."""
    colours = np.random.default_rng(seed).integers(8, 248, (ROWS, COLUMNS, 3))
    colours[0] = np.linspace(4, 250, COLUMNS).round()[:, None]
    return colours.astype(np.uint8)


def enlarged(colours):
    return colours.repeat(PATCH, 0).repeat(PATCH, 1)


def patches(picture):
    """The mean of each patch without its edges."""
    height, width = picture.shape[0] // ROWS, picture.shape[1] // COLUMNS
    inner = lambda row, column: picture[
        row * height + height // 4 : (row + 1) * height - height // 4,
        column * width + width // 4 : (column + 1) * width - width // 4,
    ]
    return np.array([[inner(r, c).reshape(-1, 3).mean(0) for c in range(COLUMNS)] for r in range(ROWS)])


def written(folder, extension, space, seed):
    """Writes a chart; returns its name and what it means in sRGB, levels of 255."""
    colours, icc = chart(seed), profile_of(space)
    picture = Image.fromarray(enlarged(colours))
    path = folder / f"{space.lower()}.{extension}"
    if extension == "heic":
        heif = pillow_heif.from_pillow(picture)
        heif.save(path, quality=-1, chroma=444, icc_profile=icc)
    else:
        options = {"jpg": {"quality": 98, "subsampling": 0}, "webp": {"lossless": True}}.get(extension, {})
        picture.save(path, icc_profile=icc, **options)
    # What the codec loses is not what is judged.
    to_srgb = ImageCms.profileToProfile(
        Image.open(path).convert("RGB"),
        ImageCms.ImageCmsProfile(io.BytesIO(icc)),
        ImageCms.ImageCmsProfile(io.BytesIO(profile_of("SRGB"))),
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    return path, patches(np.asarray(to_srgb).astype(float))


def written_raw(folder, stops, seed):
    """Writes a DNG; returns its name and LibRaw's reading, levels of 255 of sRGB."""
    light = raw_twins.to_light(enlarged(chart(seed)) / 255.0)
    # White balance must not clip a channel.
    codes = raw_twins.exposed(0.9 * light * 2.0**-stops, np.random.default_rng(seed))
    path = folder / f"raw{stops}.dng"
    path.write_bytes(raw_twins.dng(codes, 2.0**-stops))
    with rawpy.imread(str(path)) as raw:
        linear = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, no_auto_scale=False, use_camera_wb=True, output_bps=16,
            output_color=rawpy.ColorSpace.sRGB, adjust_maximum_thr=0.0, highlight_mode=rawpy.HighlightMode.Clip,
        )
    levels = 255 * raw_twins.to_srgb(patches(linear / 65535.0))
    # LibRaw cuts noise at black, which brightens channels that are nearly dark.
    return path, np.where(levels < DIM, np.nan, levels)


def prepared(fled, capture, out):
    """The light of each photograph that fled has read, by its path."""
    subprocess.run([fled, "prepare", capture, "--out", out], check=True, stdout=subprocess.DEVNULL)
    views = json.loads((out / "manifest.json").read_text())["capture"]["views"]
    read = {}
    for view in views:
        content = (out / view["prepared"]["file"]).read_bytes()
        width, height = struct.unpack("<2I", content[:8])
        planes = np.frombuffer(content[8:], "<f2").reshape(3, height, width)
        read[view["path"]] = planes.astype(float).transpose(1, 2, 0)
    return read


def main():
    pillow_heif.register_heif_opener()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fled", type=Path, default=Path("target/release/fled"))
    args = parser.parse_args()
    print(f"LittleCMS {features.version('littlecms2')}, LibRaw {'.'.join(map(str, rawpy.libraw_version))}")
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for extension, tolerance in TOLERANCES.items():
            (folder / extension).mkdir()
            if extension == "dng":
                expected = dict(written_raw(folder / extension, stops, stops) for stops in range(3))
            else:
                spaces = enumerate(SPACES)
                expected = dict(written(folder / extension, extension, space, seed) for seed, space in spaces)
            light = prepared(args.fled, folder / extension, folder / f"{extension}-read")
            for path, wanted in expected.items():
                found = 255 * raw_twins.to_srgb(patches(light[path.name]))
                difference = np.abs(found - wanted)
                worst = np.nanmax(difference)
                print(f"{path.name:14} {worst:5.2f} levels at most, {np.nanmean(difference):.2f} in the mean")
                if not worst <= tolerance:
                    failed.append(path.name)
    if failed:
        raise SystemExit(f"read otherwise than by their judges: {', '.join(failed)}")


if __name__ == "__main__":
    main()
