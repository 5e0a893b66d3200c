"""Guides as they are in the product: what its own trainer renders of captures that it makes.

    python renders.py --fled ../target/release/fled --captures 12 --out run/renders

For each capture: `fled synth` twice, dark and shaken and, of the same scene and cameras, sharp and noiseless; one round of
`fled run` without a network on the first; every view then becomes one file f16 [9, H, W]: the view brightened, its guide
(the render where it agrees), and the sharp photograph under the same curve. A capture that is there already is kept.
"""

import argparse
import shutil
import subprocess
from pathlib import Path

import numpy as np

import degrade
import sources
import tone_curve

# Far from the seeds with which anything is evaluated.
FIRST_SEED = 1000
SIZE = "320x180"


def synth(fled, folder, seed, views, exposure, blur, noise):
    """A capture by the product."""
    arguments = dict(seed=seed, views=views, size=SIZE, exposure=exposure, blur=blur, noise=noise)
    subprocess.run([fled, "synth", folder, *(f"--{key}={value}" for key, value in arguments.items())], check=True)


def photographs(folder):
    """The files of a folder in their order, f32 0..1, with their names."""
    paths = sorted(folder.iterdir())
    return [path.stem for path in paths], [sources.load(path).astype(np.float32) / 255 for path in paths]


def capture(fled, scratch, seed, views, steps):
    """(name, planes) of every view of one capture."""
    rng = np.random.default_rng(seed)
    exposure, blur, noise = rng.uniform(0.03, 0.15), rng.uniform(2, 14), np.exp(rng.uniform(np.log(0.004), np.log(0.04)))
    synth(fled, scratch / "dark", seed, views, exposure, blur, noise)
    synth(fled, scratch / "sharp", seed, views, exposure, 0, 0)
    names, dark = photographs(scratch / "dark" / "images")
    _, sharp = photographs(scratch / "sharp" / "images")
    alpha, gamma = tone_curve.automatic_target(dark)
    # A level on the way from the first round's to the last one's.
    share = rng.uniform(0.4, 1)
    alpha, gamma = 0.1 ** (1 - share) * alpha**share, gamma**share
    settings = dict(size=int(SIZE.split("x")[0]), rounds=1, steps=steps, deblur="identity", target=f"{alpha},{gamma}", seed=seed)
    subprocess.run(
        [fled, "run", scratch / "dark", "--out", scratch / "run", "--preset", "preview", "--cache", "none"]
        + [part for key, value in settings.items() for part in ("--set", f"{key}={value}")],
        check=True, stdout=subprocess.DEVNULL,
    )
    lut = tone_curve.table(tone_curve.histogram(dark), alpha)
    for name, blurry, clean in zip(names, dark, sharp):
        render = scratch / "run" / "restored" / f"{name}.png"
        if not render.exists():
            continue  # structure from motion found no pose for it
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
    for seed in range(FIRST_SEED, FIRST_SEED + options.captures):
        if any(options.out.glob(f"{seed}-*.npy")):
            continue
        scratch = options.out / f"scratch-{seed}"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        # All of a capture or nothing, so that a stopped run makes it anew.
        for name, planes in list(capture(options.fled.resolve(), scratch, seed, options.views, options.steps)):
            np.save(options.out / f"{seed}-{name}.npy", planes)
        shutil.rmtree(scratch)


if __name__ == "__main__":
    main()
