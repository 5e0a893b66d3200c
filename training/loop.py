"""What networks make of the views and guides of finished runs, without running them again.

    python loop.py RUN [RUN ...] --models ../models/small-u2w16.onnx other.onnx

A RUN is the output folder of `fled run` of two rounds or more on a capture with ground truth. Fed are the second round's
brightened views and, as their guides, the first round's renders through the curve that the run found for them, where they
agree with the view. All from the run's JPEG previews, so the figures stand a little beside those of the run itself.
Prints PSNR after a colour fit, and mean squared errors (1e-4) above and below about 3 px: a network that sharpens what is
sharp already shows in what is fine.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import scipy.ndimage as nd

import degrade
import sources
import tone_curve
from evaluate import Model, colour_fitted, table

# Of the low pass that parts fine from coarse, px.
SIGMA = 1.2


def views(run, every):
    """(view, guide, render, truth) of every n-th view."""
    matched = json.loads((run / "metrics.json").read_text())["rounds"][0]["matched"]
    names = sorted(path.name for path in (run / "rounds/2/enhanced").iterdir() if (run / "gt" / path.name).exists())

    def load(folder):
        return [sources.load(run / folder / name).astype(np.float32) / 255 for name in names]

    renders = load("rounds/1/renders")
    if len(matched) != 1:
        raise SystemExit(f"{run} has a curve a view (lut_scope=image); this reads runs with one a scene")
    bright = tone_curve.enhance(renders, *matched[0])
    found = list(zip(load("rounds/2/enhanced"), bright, load("gt")))[::every]
    return [(view, degrade.trusted(view, render), render, truth) for view, render, truth in found]


def errors(image, truth):
    """PSNR in dB, and the mean squared errors of coarse and fine, 1e-4."""
    error = colour_fitted(image, truth) - truth
    coarse = nd.gaussian_filter(error, (SIGMA, SIGMA, 0))
    return np.array([(error**2).mean(), (coarse**2).mean(), ((error - coarse) ** 2).mean()])


def row(label, found):
    total, coarse, fine = np.mean(found, 0)
    return (label, float(-10 * np.log10(total)), float(1e4 * coarse), float(1e4 * fine))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--models", type=Path, nargs="+", required=True)
    parser.add_argument("--every", type=int, default=3, help="one view of so many")
    options = parser.parse_args()
    models = {path.stem: Model(path) for path in options.models}
    for run in options.runs:
        examples = views(run, options.every)
        rows = [
            row("view", [errors(view, truth) for view, _, _, truth in examples]),
            row("render", [errors(render, truth) for _, _, render, truth in examples]),
            row("guide", [errors(guide, truth) for _, guide, _, truth in examples]),
        ]
        for name, model in models.items():
            rows.append(row(f"{name}, alone", [errors(model(view), truth) for view, _, _, truth in examples]))
            rows.append(row(f"{name}, guided", [errors(model(view, guide), truth) for view, guide, _, truth in examples]))
        print(table([str(run), "PSNR, dB", "coarse", "fine"], rows) + "\n", flush=True)


if __name__ == "__main__":
    main()
