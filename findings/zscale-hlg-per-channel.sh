#!/usr/bin/env bash
# ffmpeg's `zscale` gives the same light other colours when it is coded as HLG than when it is coded as PQ.
#
# ITU-R BT.2100 derives a display's light from HLG by one factor a pixel: the scene's luminance to the power of 0.2.
# `zscale` raises each channel to the power of 1.2 by itself. Greys agree; a saturated orange of 120, 40, 10 nits (BT.2020
# primaries) gets more saturated.
#
# Output seen with the ffmpeg 7.0.2 of imageio-ffmpeg 0.6.0, and with Debian's 5.1.9:
#   light (203, 203, 203) nits: zscale reads [203.0, 203.0, 203.0] from PQ and [203.0, 203.0, 203.0] from HLG
#   light (120, 40, 10) nits: zscale reads [120.0, 40.0, 10.0] from PQ and [138.2, 37.0, 7.0] from HLG
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/environment"
"$folder/environment/bin/pip" install --quiet imageio-ffmpeg==0.6.0
"$folder/environment/bin/python" - <<'PYTHON'
import math, struct, subprocess, sys

import imageio_ffmpeg

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()
print("ffmpeg", imageio_ffmpeg.get_ffmpeg_version())

def pq(nits):
    power = (nits / 10_000) ** (2610 / 16_384)
    return ((3424 / 4096 + 2413 / 128 * power) / (1 + 2392 / 128 * power)) ** (2523 / 32)

def hlg(rgb):
    shown = [nits / 1000 for nits in rgb]
    luminance = 0.2627 * shown[0] + 0.6780 * shown[1] + 0.0593 * shown[2]
    a = 0.17883277
    for value in shown:
        scene = value * luminance ** (1 / 1.2 - 1)
        yield math.sqrt(3 * scene) if scene <= 1 / 12 else a * math.log(12 * scene - (1 - 4 * a)) + 0.55991073

def light(transfer, code):
    """Nits that zscale sees in one colour, 16 bits a channel."""
    red, green, blue = (struct.pack("<H", round(65535 * value)) * 256 for value in code)
    filters = f"setparams=range=pc:color_primaries=bt2020:color_trc={transfer}:colorspace=gbr,zscale=t=linear:npl=1000,format=gbrpf32le"
    made = subprocess.run([FFMPEG, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "gbrp16le", "-s", "16x16", "-i", "-",
                           "-vf", filters, "-f", "rawvideo", "-"], input=green + blue + red, capture_output=True, check=True)
    planes = [struct.unpack_from("<f", made.stdout, 1024 * plane)[0] * 1000 for plane in range(3)]
    return [round(planes[index], 1) for index in (2, 0, 1)]

apart = []
for rgb in [(203, 203, 203), (120, 40, 10)]:
    by_pq, by_hlg = light("smpte2084", map(pq, rgb)), light("arib-std-b67", hlg(rgb))
    print(f"light {rgb} nits: zscale reads {by_pq} from PQ and {by_hlg} from HLG")
    apart.append(max(abs(a / b - 1) for a, b in zip(by_pq, by_hlg)))
sys.exit(0 if apart[0] < 0.02 and apart[1] > 0.1 else 1)
PYTHON
