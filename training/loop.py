"""What networks make of the views and guides of finished runs, without running them again.

    python loop.py RUN [RUN ...] --models ../models/small-u2w16.onnx other.onnx

A RUN is the output folder of `fled run` of two rounds or more on a capture with ground truth. Fed are the second round's
brightened views and, as their guides, these with seven tenths of the detail of the first round's renders where the two agree (the renders
go through the curve that the run found for them first). All from the run's JPEG previews, so the figures stand a little beside
those of the run itself. Prints PSNR after a colour fit, mean squared errors (1e-4) above and below about 3 px (a network that
sharpens what is sharp already shows in what is fine), and PSNR against what the network is asked for: the truth, as dark, under
the run's curve. "of itself" is guided by what the network makes of the view alone, from which nothing is to be learnt.
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


def views(run, every, share):
    """(view, guide, render, truth, truth under the view's curve) of every n-th view."""
    first, second = json.loads((run / "metrics.json").read_text())["rounds"][:2]
    matched, (alpha, gamma) = first["matched"], second["anchor"]
    everything = sorted(path.name for path in (run / "rounds/2/enhanced").iterdir())
    names = [name for name in everything if (run / "gt" / name).exists()]

    def load(folder, names=names):
        return [sources.load(run / folder / name).astype(np.float32) / 255 for name in names]

    if len(matched) != 1:
        raise SystemExit(f"{run} has a curve a view (lut_scope=image); this reads runs with one a scene")
    # Curves are of all views, also of those without ground truth.
    to_next = tone_curve.table(tone_curve.histogram(load("rounds/1/renders", everything)), matched[0][0])
    lut = tone_curve.table(tone_curve.histogram(load("inputs", everything)), alpha)
    found = []
    for taken, view, render, truth in list(
        zip(load("inputs"), load("rounds/2/enhanced"), load("rounds/1/renders"), load("gt"))
    )[::every]:
        render = tone_curve.apply(render, to_next, matched[0][1])
        asked = tone_curve.apply(as_dark(truth, taken), lut, gamma)
        found.append((view, degrade.trusted(view, render, share), render, truth, asked))
    return found


def as_dark(truth, taken):
    """The sharp photograph with the light of the dark one."""
    light, caught = degrade.decode(truth), degrade.decode(taken)
    return degrade.encode(light * (light * caught).sum() / (light * light).sum())


def errors(image, truth, asked):
    """Mean squared errors: all, coarse and fine after a colour fit to `truth`; and against `asked`."""
    error = colour_fitted(image, truth) - truth
    coarse = nd.gaussian_filter(error, (SIGMA, SIGMA, 0))
    return np.array([(error**2).mean(), (coarse**2).mean(), ((error - coarse) ** 2).mean(), ((image - asked) ** 2).mean()])


def row(label, make, examples):
    """Of what `make` makes of (view, guide, render)."""
    found = [errors(make(view, guide, render), truth, asked) for view, guide, render, truth, asked in examples]
    total, coarse, fine, asked = np.mean(found, 0)
    return (label, float(-10 * np.log10(total)), float(1e4 * coarse), float(1e4 * fine), float(-10 * np.log10(asked)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--models", type=Path, nargs="+", required=True)
    parser.add_argument("--every", type=int, default=3, help="one view of so many")
    parser.add_argument("--share", type=float, default=degrade.SHARE, help="of the renders' detail in the guides; the product's")
    options = parser.parse_args()
    models = {path.stem: Model(path) for path in options.models}
    for run in options.runs:
        examples = views(run, options.every, options.share)
        rows = [
            row("view", lambda view, guide, render: view, examples),
            row("render", lambda view, guide, render: render, examples),
            row("guide", lambda view, guide, render: guide, examples),
        ]
        for name, model in models.items():
            rows += [
                row(f"{name}, alone", lambda view, guide, render: model(view), examples),
                row(f"{name}, of itself", lambda view, guide, render: model(view, degrade.trusted(view, model(view), options.share)), examples),
                row(f"{name}, guided", lambda view, guide, render: model(view, guide), examples),
            ]
        print(table([str(run), "PSNR, dB", "coarse", "fine", "as asked, dB"], rows) + "\n", flush=True)


if __name__ == "__main__":
    main()
