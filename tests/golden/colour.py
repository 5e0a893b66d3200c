#!/usr/bin/env python3
"""Linear sRGB light of patches in other colour spaces, from their definitions: the constants of
src/core/image/colour/tests.rs. Needs numpy."""

import struct

import numpy as np

BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
D50_OF_ICC = np.array([0.9642, 1, 0.8249])
D65, D50 = (0.3127, 0.3290), (0.3457, 0.3585)
SRGB = [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06)]
PATCHES = [(200, 120, 60), (20, 40, 30), (128, 128, 128), (30, 220, 40)]


def xyz(x, y):
    return np.array([x / y, 1, (1 - x - y) / y])


def to_pcs(primaries, white):
    """Linear RGB to XYZ of D50, the connection space of ICC profiles."""
    matrix = np.stack([xyz(*primary) for primary in primaries], 1)
    matrix = matrix * np.linalg.solve(matrix, xyz(*white))
    cones = (BRADFORD @ D50_OF_ICC) / (BRADFORD @ xyz(*white))
    return np.linalg.inv(BRADFORD) @ np.diag(cones) @ BRADFORD @ matrix


def fixed(values):
    """Numbers of an ICC profile, 16 bits before and after the point."""
    return struct.pack(f">{len(values)}i", *(round(65536 * v) for v in values))


def profile(name, kind, tags):
    """The bytes of an ICC profile of version 2: `kind` is its class, colour space and connection space."""
    text = name.encode() + b"\0"
    tags = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(78),
        b"cprt": b"text\0\0\0\0public domain\0",
        b"wtpt": b"XYZ \0\0\0\0" + fixed(D50_OF_ICC),
        **tags,
    }
    directory, body = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    for tag, content in tags.items():
        directory += tag + struct.pack(">II", start + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = struct.pack(">I4xI", start + len(body), 0x02400000) + kind + struct.pack(">6H", 2026, 1, 1, 0, 0, 0)
    return (head + b"acsp" + bytes(28) + fixed(D50_OF_ICC)).ljust(128, b"\0") + directory + body


def srgb_curve(v):
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


SPACES = {
    "P3": ([(0.68, 0.32), (0.265, 0.69), (0.15, 0.06)], D65, srgb_curve),
    "ADOBE": ([(0.64, 0.33), (0.21, 0.71), (0.15, 0.06)], D65, lambda v: v ** (563 / 256)),
    "PROPHOTO": (
        [(0.734699, 0.265301), (0.159597, 0.840403), (0.036598, 0.000105)],
        D50,
        lambda v: np.where(v < 16 / 512, v / 16, v**1.8),
    ),
    "LINEAR": (SRGB, D65, lambda v: v),
    "SRGB": (SRGB, D65, srgb_curve),
}

if __name__ == "__main__":
    for name, (primaries, white, curve) in SPACES.items():
        matrix = np.linalg.inv(to_pcs(SRGB, D65)) @ to_pcs(primaries, white)
        for patch in PATCHES:
            print(name, patch, np.round(matrix @ curve(np.array(patch) / 255), 5).tolist())
