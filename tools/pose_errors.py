"""Errors of estimated cameras, per view, after the similarity that makes most of them good."""

import itertools
import math

import numpy as np

# Shares of the largest distance between two true cameras, and degrees.
GOOD, WRONG = (0.03, 3.0), (0.06, 6.0)


def rotation(w, x, y, z):
    """Of a unit quaternion."""
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def of_colmap_text(path):
    """{stem: (rotation, centre)} of COLMAP's images.txt, world to camera."""
    cameras = {}
    for line in path.read_text().splitlines():
        fields = line.split()
        if len(fields) == 10 and fields[0] != "#" and "." in fields[9]:
            turn = rotation(*map(float, fields[1:5]))
            shift = np.array([float(value) for value in fields[5:8]])
            cameras[fields[9].rsplit(".", 1)[0]] = (turn, -turn.T @ shift)
    return cameras


def of_fled(poses):
    """The same of the content of fled's poses.json."""
    cameras = {}
    for view in poses["views"]:
        matrix = np.array(view["camera"]["world_to_camera"]).reshape(4, 4).T
        cameras[view["name"]] = (matrix[:3, :3], -matrix[:3, :3].T @ matrix[:3, 3])
    return cameras


def fitted(estimated, true):
    """Scale, rotation and translation between paired centres, least squares (Umeyama 1991)."""
    middle_from, middle_to = estimated.mean(0), true.mean(0)
    a, b = estimated - middle_from, true - middle_to
    u, spread, v = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.sign(np.linalg.det(u @ v))])
    turn = u @ np.diag(signs) @ v
    scale = (spread * signs).sum() / max((a * a).sum(), 1e-30)
    return scale, turn, middle_to - scale * turn @ middle_from


def by_pair(estimated, true, first, second):
    """The similarity that aligns the positions of two cameras and the rotation of the first."""
    turn = true[first][0].T @ estimated[first][0]
    apart = np.linalg.norm(estimated[second][1] - estimated[first][1])
    scale = np.linalg.norm(true[second][1] - true[first][1]) / max(apart, 1e-12)
    return scale, turn, true[first][1] - scale * turn @ estimated[first][1]


def errors(estimated, true, names, similarity, extent):
    """(share of the extent, degrees) per view."""
    scale, turn, shift = similarity
    found = []
    for name in names:
        (turn_est, centre_est), (turn_true, centre_true) = estimated[name], true[name]
        away = np.linalg.norm(scale * turn @ centre_est + shift - centre_true) / extent
        cosine = (np.trace(turn_est @ turn.T @ turn_true.T) - 1) / 2
        found.append((away, math.degrees(math.acos(min(1.0, max(-1.0, cosine))))))
    return found


def judged(estimated, true):
    """{name: (share, degrees)} of the estimated views, by the similarity that makes most good."""
    names = sorted(set(estimated) & set(true))
    if len(names) < 2:
        return dict.fromkeys(names, (math.inf, 180.0))
    centres = np.array([centre for _, centre in true.values()])
    extent = max(np.linalg.norm(a - b) for a, b in itertools.combinations(centres, 2))
    best = None
    for first, second in itertools.permutations(names, 2):
        similarity = by_pair(estimated, true, first, second)
        for _ in range(3):
            found = errors(estimated, true, names, similarity, extent)
            good = [name for name, error in zip(names, found) if is_good(error)]
            rank = (len(good), -sum(min(away, 1.0) for away, _ in found))
            if best is None or rank > best[0]:
                best = (rank, found)
            if len(good) < 3:
                break
            similarity = fitted(
                np.array([estimated[name][1] for name in good]), np.array([true[name][1] for name in good]),
            )
    return dict(zip(names, best[1]))


def is_good(error):
    return error[0] <= GOOD[0] and error[1] <= GOOD[1]


def is_wrong(error):
    return error[0] > WRONG[0] or error[1] > WRONG[1]
