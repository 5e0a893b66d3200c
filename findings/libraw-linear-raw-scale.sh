#!/usr/bin/env bash
# LibRaw 0.22.2 (rawpy 0.28.0): a LinearRaw DNG with a black level comes out darker than the same light in a Bayer DNG.
#
# DNG defines linear light as (raw - BlackLevel) / (WhiteLevel - BlackLevel). LibRaw computes this for Bayer data. For
# LinearRaw data, which phones write after merging a burst, it subtracts the black level but divides by WhiteLevel, so
# every value is too small by the factor (WhiteLevel - BlackLevel) / WhiteLevel: 0.8750 for 512 and 4095.
#
# Output seen with Python 3.11, rawpy 0.28.0, numpy 2.4.6, tifffile 2026.3.3:
#   light 0.05: Bayer 0.0500, LinearRaw 0.0437, ratio 0.875
#   light 0.20: Bayer 0.2001, LinearRaw 0.1751, ratio 0.875
#   light 0.50: Bayer 0.5001, LinearRaw 0.4376, ratio 0.875
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv environment
environment/bin/pip install --quiet rawpy==0.28.0 numpy==2.4.6 tifffile==2026.3.3
cat >check.py <<'PYTHON'
import numpy
import rawpy
import tifffile

BLACK, WHITE = 512, 4095
CFA, LINEAR_RAW = 32803, 34892
IDENTITY = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)


def write(path, samples, photometric):
    planes = 1 if photometric == CFA else 3
    tags = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50708, "s", 0, "Synthetic Camera", True),  # UniqueCameraModel
        (50714, "H", planes, BLACK if planes == 1 else (BLACK,) * 3, True),  # BlackLevel
        (50717, "I", planes, WHITE if planes == 1 else (WHITE,) * 3, True),  # WhiteLevel
        (50721, "2i", 9, IDENTITY, True),  # ColorMatrix1
        (50728, "2I", 3, (1,) * 6, True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    if photometric == CFA:
        tags += [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([0, 1, 1, 2]), True)]
    layout = None if planes == 1 else 1
    tifffile.imwrite(
        path, samples, photometric=photometric, extratags=tags, planarconfig=layout, metadata=None
    )


def light_in(path):
    with rawpy.imread(path) as raw:
        black, white = raw.black_level_per_channel[0], raw.white_level
        assert (black, white) == (BLACK, WHITE), f"levels read as {black}, {white}"
        picture = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            output_bps=16,
            output_color=rawpy.ColorSpace.raw,
            user_wb=[1, 1, 1, 1],
        )
    return picture[16:48, 16:48].mean() / 65535


print("rawpy", rawpy.__version__, "LibRaw", ".".join(map(str, rawpy.libraw_version)))
for light in (0.05, 0.2, 0.5):
    value = round(BLACK + light * (WHITE - BLACK))
    write("bayer.dng", numpy.full((64, 64), value, numpy.uint16), CFA)
    write("linear.dng", numpy.full((64, 64, 3), value, numpy.uint16), LINEAR_RAW)
    bayer, linear = light_in("bayer.dng"), light_in("linear.dng")
    print(f"light {light:.2f}: Bayer {bayer:.4f}, LinearRaw {linear:.4f}, ratio {linear / bayer:.3f}")
    assert abs(bayer - light) < 0.001, "Bayer data are no longer right"
    assert abs(linear / bayer - (WHITE - BLACK) / WHITE) < 0.002, "the scale of LinearRaw has changed"
PYTHON
environment/bin/python check.py
