"""Judges the product's renders by the published formulas (published.py).

    python judge.py RUN PICTURES

RUN holds scene.ply and cameras.json; every PICTURES/NAME.png is what `fled render RUN --view NAME` made of them. Exits
with 1 and says why when a picture is not within LEAST and OFF_MOST, or when a spoilt scene is not told from the good one.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

import published

# dB. A picture's 8 bits alone allow 58.9: their error is uniform, of variance 1 / (12 255^2).
LEAST = 45.0
# Share of values more than a grey level off: the mean hardly sees a wrong cap of alpha (0.1 dB), this does. A few pixels
# may be, where f32 and f64 fall on different sides of a limit.
OFF_MOST = 2e-4


@dataclass
class Verdict:
    """How far a picture is from the formulas': PSNR in dB, the share of values more than a grey level off, and the
    largest difference of a value in 0..1."""

    name: str
    psnr: float
    off: float
    largest: float


def compare(name, expected, picture):
    """The verdict on a picture [height, width, 3] in 0..1."""
    if expected.shape != picture.shape:
        raise SystemExit(f"{name}: a picture of {picture.shape}, expected {expected.shape}")
    difference = np.abs(np.clip(expected, 0, 1) - picture)
    error = max(float((difference**2).mean()), 1e-12)
    off = float((difference > 1.001 / 255).mean())
    return Verdict(name, float(-10 * np.log10(error)), off, float(difference.max()))


def load_picture(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), np.float64) / 255


def judge(scene, cameras, pictures):
    """Verdicts on pictures by the name of their camera."""
    unknown = sorted(set(pictures) - set(cameras))
    if unknown or not pictures:
        raise SystemExit(f"pictures of unknown cameras: {unknown}" if unknown else "there are no pictures to judge")
    return [compare(name, published.render(scene, cameras[name]), picture) for name, picture in pictures.items()]


def with_swapped_quaternions(scene):
    """The scene of a reader that takes w x y z for x y z w."""
    return replace(scene, rotations=np.roll(scene.rotations, 1, 1))


def objections(verdicts, spoilt):
    """What is wrong, a line each; nothing when the pictures agree and the spoilt scene's verdicts do not."""
    lines = [f"{v.name}: {v.psnr:.2f} dB, {LEAST:.0f} wanted" for v in verdicts if v.psnr < LEAST]
    lines += [f"{v.name}: {v.off:.3%} more than a grey level off, at most {OFF_MOST:.3%} wanted" for v in verdicts
              if v.off > OFF_MOST]
    blind = [v for v in spoilt if v.psnr >= LEAST]
    lines += [f"{v.name}: {v.psnr:.2f} dB with swapped quaternions: this judge sees nothing" for v in blind]
    return lines


def report(verdicts, spoilt):
    """A Markdown table."""
    def row(name, v):
        return f"| {name} | {v.psnr:.2f} | {v.off:.3%} | {255 * v.largest:.2f} |"

    lines = ["| camera | PSNR, dB | more than a grey level off | most, grey levels |", "|---|---|---|---|"]
    lines += [row(v.name, v) for v in verdicts]
    lines += [row(f"{v.name}, quaternions swapped", v) for v in spoilt]
    return "\n".join(lines)


def arguments(about):
    """The scene and the cameras of the run on the command line, and the folder of pictures."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("pictures", type=Path)
    options = parser.parse_args()
    scene = published.read_scene(options.run / "scene.ply")
    return scene, published.read_cameras(options.run / "cameras.json"), options.pictures


def main():
    scene, cameras, folder = arguments(__doc__)
    pictures = {path.stem: load_picture(path) for path in sorted(folder.glob("*.png"))}
    verdicts = judge(scene, cameras, pictures)
    first = {name: pictures[name] for name in list(pictures)[:1]}
    spoilt = judge(with_swapped_quaternions(scene), cameras, first)
    print(report(verdicts, spoilt), flush=True)
    wrong = objections(verdicts, spoilt)
    if wrong:
        raise SystemExit("not as published:\n  " + "\n  ".join(wrong))


if __name__ == "__main__":
    main()
