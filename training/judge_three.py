"""Judges three.js' pictures of a scene: they must be the published ones, but for what three.js does otherwise.

    python judge_three.py RUN PICTURES

RUN holds scene.ply and cameras.json; PICTURES is what tools/three_pictures.mjs made of the run's scene.glb. three.js
0.187.0 draws a Gaussian up to two standard deviations, takes from its opacity what the low-pass adds to its area, sorts
into 4,096 bins of depth and has no limits of alpha. Exits with 1 and says why when a picture is not within LEAST, or when
harmonics of another orientation are not told from the right ones.
"""

import json
import math
from dataclasses import replace

import numpy as np

import published
from judge import arguments, compare, load_picture

# dB
LEAST = 40.0
# Squared standard deviations.
REACH = 4.0
BINS = 4096
# Half sizes of the picture beyond which the centre of a Gaussian that is drawn does not lie.
BORDER = 1.4
NEAR = 0.01


def order(depths, near, far):
    """Nearest bin first; within one, as three.js draws from behind, the last one of the file first."""
    bins = np.floor((depths - near) * ((BINS - 1) / (far - near))).clip(0, BINS - 1)
    return np.lexsort((-np.arange(len(depths)), bins))


def draw(scene, camera, near, far):
    """RGB [height, width, 3] as three.js draws it, in f64."""
    points = scene.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    places = points[:, :2] / points[:, 2:] * camera.focal + camera.centre
    half = np.array([camera.width, camera.height]) / 2
    inside = (points[:, 2] > NEAR) & (np.abs(places / half - 1) <= BORDER).all(1)
    drawn = order(points[:, 2], near, far)
    drawn = drawn[inside[drawn]]
    scene, points, places = replace(scene, **{name: value[drawn] for name, value in vars(scene).items()}), points[drawn], places[drawn]
    flat = published.flat_covariances(scene, camera, points, slope_limit=math.inf)
    a, b, c = flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1]
    determinant = a * c - b * b
    before = (a - published.LOW_PASS) * (c - published.LOW_PASS) - b * b
    opacities = np.sqrt(np.maximum(before / determinant, 0)) / (1 + np.exp(-scene.opacity_logits))
    colours = published.colours(scene, camera).clip(0, 1)
    conics = np.stack([c, b, a], 1) / determinant[:, None] * [1, -1, 1]
    rows = np.zeros((camera.height, camera.width, 3))
    for row in range(camera.height):
        dy = row + 0.5 - places[:, 1]
        near_row = dy**2 * (conics[:, 2] - conics[:, 1] ** 2 / conics[:, 0]) < REACH
        (p, q, r), dy = conics[near_row].T[..., None], dy[near_row][:, None]
        dx = np.arange(camera.width) + 0.5 - places[near_row, 0][:, None]
        squares = p * dx * dx + 2 * q * dx * dy + r * dy * dy
        alpha = np.where(squares > REACH, 0, opacities[near_row][:, None] * np.exp(-0.5 * squares))
        left = np.cumprod(1 - alpha, 0)
        before = np.concatenate([np.ones((1, camera.width)), left[:-1]])
        rows[row] = (alpha * before).T @ colours[near_row]
    return rows


def with_turned_harmonics(scene):
    """The scene of a viewer that looks at its odd harmonics from the other side."""
    harmonics = scene.harmonics.copy()
    harmonics[:, 1:4] *= -1
    return replace(scene, harmonics=harmonics)


def main():
    scene, cameras, folder = arguments(__doc__)
    wrong = []
    for name, depths in json.loads((folder / "depths.json").read_text()).items():
        picture, camera = load_picture(folder / f"{name}.png"), cameras[name]
        own, like, turned = (compare(name, expected, picture).psnr for expected in (
            published.render(scene, camera), draw(scene, camera, *depths), draw(with_turned_harmonics(scene), camera, *depths)))
        print(f"three.js draws {name}: {own:.2f} dB from the published picture, {like:.2f} dB from it as three.js draws, "
              f"{turned:.2f} dB with turned harmonics")
        if like < LEAST or turned > like - 3:
            wrong.append(name)
    if wrong:
        raise SystemExit(f"three.js draws otherwise: {', '.join(wrong)}; {LEAST:.0f} dB wanted, and 3 dB less with turned harmonics")


if __name__ == "__main__":
    main()
