#!/usr/bin/env python3
"""Writes tone_curve.json: what the training recipe's tone curve makes of a small dark photograph.

Run once, with the result committed: `pip install numpy`, then `python tests/golden/tone_curve.py`. The photograph is made
by formula, the same in the test that reads the numbers.
"""

import json
import pathlib
import sys

import numpy as np

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parent.parent / "training"))

import tone_curve

ANCHORS = [(0.1, 1.0), (1.3, 0.8), (3.6, 0.55), (10.0, 0.8), (0.0, 0.5)]


def photograph():
    """16 x 8 px, dark, coloured: a linear congruence, squared."""
    values, state = [], 7
    for _ in range(16 * 8 * 3):
        state = (state * 1_664_525 + 1_013_904_223) % 2**32
        uniform = (state >> 8) / 2**24
        values.append(0.4 * uniform * uniform)
    return np.array(values, np.float32).reshape(8, 16, 3)


def golden():
    dark = photograph()
    curves = [
        {"alpha": alpha, "gamma": gamma, "values": tone_curve.enhance([dark], alpha, gamma)[0].ravel().tolist()}
        for alpha, gamma in ANCHORS
    ]
    return {"curves": curves, "automatic": tone_curve.automatic_target([dark])}


if __name__ == "__main__":
    rounded = json.loads(json.dumps(golden()), parse_float=lambda text: round(float(text), 9))
    (HERE / "tone_curve.json").write_text(json.dumps(rounded) + "\n")
