"""A made-up scene that asks more of a renderer than a trained one does, in the layout of a run's folder.

    python strange.py FOLDER    # prints how many Gaussians it wrote

Harmonics of degree 3, needles and discs, quaternions of any length, opacities on both sides of every limit, walls deep
enough to stop the blending, and large Gaussians beside the picture, where the Jacobian is clamped.
"""

import json
import sys
from pathlib import Path

import numpy as np
import plyfile

COUNT = 600
SIZE = (200, 120)
FOCAL = 150.0
# All cameras are held askew by that many degrees, so that the node of a glTF file rotates.
ROLL = 20
# Degrees about the vertical axis, and where the camera stands then.
CAMERAS = {"front": (0, (0, 0, -4)), "left": (25, (-1.8, 0.3, -3.4)), "near": (-10, (0.4, -0.2, -2.2))}


def gaussians(seed, count=COUNT):
    """A column of values for every property of the PLY file."""
    rng = np.random.default_rng(seed)
    # The last tenth is large and lies beside the picture.
    beside = np.arange(count) >= 0.9 * count
    places = rng.uniform(-1, 1, (count, 3)) * [2.2, 1.3, 1.0]
    places[beside, 0] = rng.choice([-1, 1], beside.sum()) * rng.uniform(3.5, 5, beside.sum())
    scales = rng.uniform(np.log(0.01), np.log(0.3), (count, 3)) + np.where(beside, 1.0, 0.0)[:, None]
    columns = dict(zip("xyz", places.T))
    columns |= {name: np.zeros(count) for name in ("nx", "ny", "nz")}
    columns |= {f"f_dc_{n}": rng.normal(0, 1, count) for n in range(3)}
    columns |= {f"f_rest_{n}": rng.normal(0, 0.15, count) for n in range(45)}
    columns["opacity"] = rng.uniform(-7, 9, count)
    columns |= {f"scale_{n}": scales[:, n] for n in range(3)}
    columns |= {f"rot_{n}": rng.normal(0, 1, count) for n in range(4)}
    return columns


def write_ply(path, columns):
    """Little endian floats, in the order given."""
    kind = np.dtype([(name, "<f4") for name in columns])
    vertices = np.empty(len(next(iter(columns.values()))), kind)
    for name, values in columns.items():
        vertices[name] = values
    plyfile.PlyData([plyfile.PlyElement.describe(vertices, "vertex")], byte_order="<").write(path)


def camera(name, degrees, place, roll=0):
    """An entry of `cameras.json`."""
    (sine, cosine), (rise, run) = ((np.sin(angle), np.cos(angle)) for angle in np.radians([degrees, roll]))
    pose = np.eye(4)
    turned = [[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]]
    pose[:3, :3] = np.array([[run, rise, 0], [-rise, run, 0], [0, 0, 1]]) @ turned
    pose[:3, 3] = -pose[:3, :3] @ place
    return {
        "name": name, "split": "held_out", "width": SIZE[0], "height": SIZE[1], "fx": FOCAL, "fy": 1.02 * FOCAL,
        "cx": SIZE[0] / 2, "cy": SIZE[1] / 2, "world_to_camera": pose.tolist(),
    }


def main():
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / "scene.ply", gaussians(seed=5))
    cameras = [camera(name, *stand, ROLL) for name, stand in CAMERAS.items()]
    (folder / "cameras.json").write_text(json.dumps(cameras, indent=1))
    print(COUNT)


if __name__ == "__main__":
    main()
