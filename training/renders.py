"""Guides as they are in the product: what its own trainer renders of captures that it makes.

    python renders.py --fled ../target/release/fled --captures 25 --out run/renders

For each capture: `fled synth` of a room of its own (room 0, in which everything is measured, is left out), two thirds of them
with the training photographs on the walls; one round of `fled run` on COLMAP's poses; every view then becomes one file f16
[9, H, W]: the view brightened, its render, and the sharp photograph, as dark, under the same curve, all without the distortion
that COLMAP found. Shake, noise, views, steps and Gaussians are drawn far apart, so that there are renders much better and much
worse than their views. A third of the scenes are trained with kernels for the shake, a third on what the built-in network
leaves, a third on the views alone. A capture that is there already is kept; one whose photographs COLMAP cannot place is left
out, and `ROOM.none` says so.
"""

import argparse
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
from PIL import Image

import degrade
import lens
import sources
import tone_curve

SIZE = "320x180"


class NoPoses(Exception):
    """COLMAP could not place the photographs."""


def photograph(folder, view):
    """The photograph of a view of `poses.json`, f32 [H, W, 3] 0..1, as the product undistorts it."""
    image = sources.load(folder / f"{view['name']}.png").astype(np.float32) / 255
    return lens.undistorted(image, view["lens"], view["camera"]["intrinsics"])


def reconstruct(fled, capture, out, settings):
    """`fled run`; raises NoPoses, or SystemExit with its last words on any other failure."""
    command = [fled, "run", capture, "--out", out, "--preset", "preview", "--cache", "none", "--json"]
    done = subprocess.run(command + options(settings), stdout=subprocess.PIPE, text=True)
    if done.returncode:
        said = [json.loads(line) for line in done.stdout.splitlines()]
        failed = [event for event in said if event["event"] == "failed"]
        if failed and failed[-1]["kind"] == "few_poses":
            raise NoPoses
        raise SystemExit(f"fled run failed: {failed or done.returncode}")


LOOPS = [
    dict(deblur="identity", shake="kernel"),
    dict(deblur="small-u2w16", shake="off"),
    dict(deblur="identity", shake="off"),
]


def log_uniform(rng, low, high):
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def wallpapers(folder):
    """Fills a folder with the training photographs but for the landscapes, each as often as it counts."""
    folder.mkdir()
    for path in sources.TRAINING:
        if path in sources.TRAINING_LANDSCAPES:
            continue
        first = folder / f"{path.name}-0.png"
        Image.fromarray(sources.photograph(path)).save(first)
        for number in range(1, sources.WEIGHTS.get(path.stem, 1)):
            shutil.copy(first, folder / f"{path.name}-{number}.png")
    return folder


def options(values):
    """Arguments of `fled run` that set these."""
    return [part for key, value in values.items() for part in ("--set", f"{key}={value}")]


def capture(fled, scratch, room):
    """(name, planes) of every view of one capture."""
    rng = np.random.default_rng(room)
    exposure = log_uniform(rng, 0.03, 0.3)
    made = dict(
        seed=room, room=room, views=rng.integers(12, 31), size=SIZE, exposure=exposure,
        blur=log_uniform(rng, 0.7, 14), noise=log_uniform(rng, 0.004, 0.05),
    )
    if rng.random() < 2 / 3:
        made["wallpapers"] = wallpapers(scratch / "wallpapers")
    subprocess.run([fled, "synth", scratch / "dark", *(f"--{key}={value}" for key, value in made.items())], check=True)
    # The target by the photographs as taken: the run is told it before it knows how the lens bends.
    files = sorted((scratch / "dark" / "images").iterdir())
    alpha, gamma = tone_curve.automatic_target([sources.load(path).astype(np.float32) / 255 for path in files])
    # A level on the way from the first round's to the last one's.
    share = rng.uniform(0.4, 1)
    alpha, gamma = 0.1 ** (1 - share) * alpha**share, gamma**share
    settings = dict(
        size=int(SIZE.split("x")[0]), rounds=1, target=f"{alpha},{gamma}", seed=room, pose_source="colmap",
        steps=int(log_uniform(rng, 150, 900)), cap=int(log_uniform(rng, 2_000, 12_000)), **LOOPS[room % 3],
    )
    reconstruct(fled, scratch / "dark", scratch / "run", settings)
    views = json.loads((scratch / "run" / "poses.json").read_text())["views"]
    dark = [photograph(scratch / "dark" / "images", view) for view in views]
    lut = tone_curve.table(tone_curve.histogram(dark), alpha)
    for view, blurry in zip(views, dark):
        # From the bright picture: eight bits of a dark one would leave bands, which the network would be paid to draw.
        clean = degrade.encode(degrade.decode(photograph(scratch / "dark" / "HL", view)) * exposure)
        blurry, clean = (tone_curve.apply(image, lut, gamma) for image in (blurry, clean))
        render = sources.load(scratch / "run" / "restored" / f"{view['name']}.png").astype(np.float32) / 255
        yield view["name"], np.moveaxis(np.concatenate([blurry, render, clean], 2), 2, 0).astype(np.float16)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fled", type=Path, required=True, help="the program")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--captures", type=int, default=25)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for room in range(1, arguments.captures + 1):
        none = arguments.out / f"{room}.none"
        if none.exists() or any(arguments.out.glob(f"{room}-*.render.npy")):
            continue
        scratch = arguments.out / f"scratch-{room}"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        try:
            for name, planes in capture(arguments.fled.resolve(), scratch, room):
                np.save(scratch / f"{room}-{name}.render.npy", planes)
        except NoPoses:
            none.touch()
        else:
            # All of a capture at once, so that a stopped run makes it anew.
            for path in scratch.glob("*.render.npy"):
                path.rename(arguments.out / path.name)
        shutil.rmtree(scratch)


if __name__ == "__main__":
    main()
