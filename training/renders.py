"""Guides as they are in the product: what its own trainer renders of captures that it makes.

    python renders.py --fled ../target/release/fled --captures 12 --out run/renders

For each capture: `fled synth` of a room of its own (room 0, in which everything is measured, is left out), one round of `fled
run`; every view then becomes one file f16 [9, H, W]: the view brightened, its guide (the render where it agrees), and the
sharp photograph, as dark, under the same curve. Half of the scenes are trained with kernels for the shake and without a
network, so their renders are sharp; half on what the built-in network leaves, so theirs are blurred, as in the loop. A
capture that is there already is kept.
"""

import argparse
import shutil
import subprocess
from pathlib import Path

import numpy as np

import degrade
import sources
import tone_curve

SIZE = "320x180"


def photographs(folder):
    """The files of a folder in their order, f32 0..1, with their names."""
    paths = sorted(folder.iterdir())
    return [path.stem for path in paths], [sources.load(path).astype(np.float32) / 255 for path in paths]


def capture(fled, scratch, room, views, steps):
    """(name, planes) of every view of one capture."""
    rng = np.random.default_rng(room)
    exposure, blur, noise = rng.uniform(0.03, 0.15), rng.uniform(2, 14), np.exp(rng.uniform(np.log(0.004), np.log(0.04)))
    arguments = dict(seed=room, room=room, views=views, size=SIZE, exposure=exposure, blur=blur, noise=noise)
    subprocess.run([fled, "synth", scratch / "dark", *(f"--{key}={value}" for key, value in arguments.items())], check=True)
    names, dark = photographs(scratch / "dark" / "images")
    # From the bright picture: eight bits of a dark one would leave bands, which the network would be paid to draw.
    _, bright = photographs(scratch / "dark" / "HL")
    alpha, gamma = tone_curve.automatic_target(dark)
    # A level on the way from the first round's to the last one's.
    share = rng.uniform(0.4, 1)
    alpha, gamma = 0.1 ** (1 - share) * alpha**share, gamma**share
    loop = dict(deblur="identity", shake="kernel") if room % 2 else dict(deblur="default", shake="off")
    settings = dict(size=int(SIZE.split("x")[0]), rounds=1, steps=steps, target=f"{alpha},{gamma}", seed=room, **loop)
    subprocess.run(
        [fled, "run", scratch / "dark", "--out", scratch / "run", "--preset", "preview", "--cache", "none"]
        + [part for key, value in settings.items() for part in ("--set", f"{key}={value}")],
        check=True, stdout=subprocess.DEVNULL,
    )
    lut = tone_curve.table(tone_curve.histogram(dark), alpha)
    for name, blurry, sharp in zip(names, dark, bright):
        render = scratch / "run" / "restored" / f"{name}.png"
        if not render.exists():
            continue  # structure from motion found no pose for it
        clean = degrade.encode(degrade.decode(sharp) * exposure)
        blurry, clean = (tone_curve.apply(image, lut, gamma) for image in (blurry, clean))
        guide = degrade.trusted(blurry, sources.load(render).astype(np.float32) / 255)
        planes = np.moveaxis(np.concatenate([blurry, guide, clean], 2), 2, 0)
        yield name, planes.astype(np.float16)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fled", type=Path, required=True, help="the program")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--captures", type=int, default=12)
    parser.add_argument("--views", type=int, default=24, help="photographs of a capture")
    parser.add_argument("--steps", type=int, default=600, help="of training a capture's scene")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for room in range(1, options.captures + 1):
        if any(options.out.glob(f"{room}-*.npy")):
            continue
        scratch = options.out / f"scratch-{room}"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        for name, planes in capture(options.fled.resolve(), scratch, room, options.views, options.steps):
            np.save(scratch / f"{room}-{name}.npy", planes)
        # All of a capture at once, so that a stopped run makes it anew.
        for path in scratch.glob("*.npy"):
            path.rename(options.out / path.name)
        shutil.rmtree(scratch)


if __name__ == "__main__":
    main()
