#!/usr/bin/env python3
"""Writes clahe.json: OpenCV's CLAHE table with a 1x1 grid at four clip limits.

Run once, with the result committed: `pip install opencv-python-headless numpy`, then
`python tests/golden/clahe.py`. The picture is made by formula, the same in the test that reads the numbers.
"""

import json
from pathlib import Path

import cv2
import numpy


def picture() -> numpy.ndarray:
    """64 x 48 px, dark, followed by one pixel of every value, so that the whole table shows."""
    values, state = [], 1
    for _ in range(3072 - 256):
        state = (state * 1_664_525 + 1_013_904_223) % 2**32
        uniform = state >> 16
        squared = (uniform * uniform) >> 16
        values.append((((squared * squared) >> 16) * 200) >> 16)
    return numpy.array(values + list(range(256)), numpy.uint8).reshape(48, 64)


def main() -> None:
    source = picture()
    tables = {}
    for alpha in ("0.1", "1", "3", "10"):
        out = cv2.createCLAHE(clipLimit=float(alpha), tileGridSize=(1, 1)).apply(source)
        tables[alpha] = [int(v) for v in out.ravel()[-256:]]
    (Path(__file__).parent / "clahe.json").write_text(json.dumps(tables) + "\n")


if __name__ == "__main__":
    main()
