"""Write src/core/features/reference.json: what the published XFeat and LighterGlue make of two small pictures.

    venv/bin/python matcher_reference.py

Refuses to write unless the steps below, made by ONNX Runtime and NumPy, give the same: they are what the product does.

The pictures. Grey, 8 bits, part of one plane of integers (u, v): pixel (x, y) of a picture of `size` at `corner` is
plane(corner[0] + x, corner[1] + y). So what is at p in picture a is at p + a.corner - b.corner in picture b.
The second's sides are no multiples of 32. With integer division and remainder, hash(n) the 32 bits of lowbias32
(n ^= n >> 16; n *= 0x7FEB352D; n ^= n >> 15; n *= 0x846CA68B; n ^= n >> 16; modulo 2^32), and
at(salt, i, j) = hash(2^24 salt + 2^12 j + i):

    plane(u, v):
        tile = at(1, u / 20, v / 20)
        h = at(2, u / 24, v / 24)
        du = u % 24 - 6 - h % 12
        dv = v % 24 - 6 - (h >> 8) % 12
        value = 50 + tile % 110
        if du du + dv dv < 8 + (h >> 16) % 40: value += 70 if the highest bit of h is set, else -45
        return value + at(3, u, v) % 8

The input is value / 255 in f32.

From picture to points (XFeat.detectAndCompute with its defaults, top_k 64). Sizes are W x H px; everything in f32.
 1. Resize to W' = 32 (W / 32), H' = 32 (H / 32) (integer division), bilinear, half-pixel centres, no low-pass:
    source = (target + 0.5) W / W' - 0.5, not below 0; its two neighbours, the right one not beyond the edge. The same
    picture where the sides are multiples already. Colour becomes grey, the mean of the channels.
 2. The network: `descriptors` (already of length 1 at every cell), `keypoints`, `reliability`, a cell for 8 x 8 px,
    w = W' / 8 cells by h = H' / 8.
 3. Heat of every pixel: softmax of `keypoints` over its 65 channels, the last dropped; pixel (8 i + a, 8 j + b) of
    column and row is channel 8 b + a of cell (i, j).
 4. Points: pixels whose heat is above 0.05 and equals the largest heat of the 5 x 5 px around them, as many as are
    inside the image. Equal neighbours are all points.
 5. Score: heat at the point times reliability there. Reliability is sampled bilinearly at the column
    x w / (W' - 1) - 0.5 and the row y h / (H' - 1) - 0.5 (so the corners of pixels are the corners of the map); a
    neighbour outside the map counts as 0. The published code samples the heat, too, as the nearest of column
    x W' / (W' - 1) - 0.5, which is x but for the last column, and row alike: there it is outside. So: points in the
    last column or the last row have score 0. The point (0, 0) has none either (it stands for "no point").
 6. The `top_k` points by score, highest first, of those whose score is above 0.
 7. Descriptor: sampled bicubically at the same column and row as reliability: 4 x 4 neighbours of the cell
    floor(column), floor(row), cubic convolution with A = -0.75 (weights of distances d: for d <= 1
    ((A + 2) d - (A + 3)) d d + 1, for d < 2 ((A d - 5 A) d + 8 A) d - 4 A), a neighbour outside the map counts as 0;
    then divided by its length (at least 1e-12).
 8. Coordinates of the picture: x W / W', y H / H'. No half pixel is added: pixel (0, 0) stays at 0.

From points to matches (XFeat.match_lighterglue; kornia's LightGlue, nothing pruned).
 1. Points: (x - W / 2) / (max(W, H) / 2), (y - H / 2) / (max(W, H) / 2), W x H the size before step 1 above.
 2. The network: `scores` [m, n].
 3. The best column of every row and the best row of every column (the first of equal ones). A match is a pair that is
    either's best and whose score is above 0.1, in the order of rows. Without points on one side: none.

The published matcher prunes points between its layers that it takes for hopeless (width_confidence 0.95; on a CPU at
any number of points); the graph prunes none. On these pictures both give the same matches; `pruned` has the
published scores.

The file. `pictures`: size, corner, `checksum` (the sum of all values), and `points`: [x, y, score], in the order of
step 6; `descriptors` likewise, rounded to five digits. `matches`: [row, column, score] of the first picture's
points against the second's, made from the points and descriptors as they stand in the file. `scores`: [row, column,
score] at some places, likewise. `dense`: [channel, row, column, value] of the first picture's `descriptors`,
`keypoints` and `reliability` at some places.
"""

import json
from pathlib import Path

import numpy as np
import torch

import matcher_check
from matcher_check import OUTPUTS, TOP, LighterGlue

PICTURES = ({"size": (160, 128), "corner": (0, 0)}, {"size": (171, 141), "corner": (6, 6)})
COUNT, THRESHOLD, WINDOW = 64, 0.05, 5
# Of what the described steps give, from what is published.
TOLERANCE = 1e-4
# Scores that are nearer than this could change places.
APART = 1e-5


def at(salt, i, j):
    n = np.uint64(salt << 24) + (j.astype(np.uint64) << 12) + i.astype(np.uint64)
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 1)):
        n = ((n ^ (n >> np.uint64(shift))) * np.uint64(factor)) & np.uint64(0xFFFFFFFF)
    return n.astype(np.int64)


def plane(u, v):
    tile, h = at(1, u // 20, v // 20), at(2, u // 24, v // 24)
    du, dv = u % 24 - 6 - h % 12, v % 24 - 6 - (h >> 8) % 12
    inside = du * du + dv * dv < 8 + (h >> 16) % 40
    return 50 + tile % 110 + np.where(inside, np.where(h >> 31 == 1, 70, -45), 0) + at(3, u, v) % 8


def picture(size, corner):
    """Integers [height, width]."""
    v, u = np.mgrid[: size[1], : size[0]]
    return plane(u + corner[0], v + corner[1])


def resized(image, width, height):
    """Step 1."""
    def along(image, length):
        source = np.maximum((np.arange(length) + 0.5) * len(image) / length - 0.5, 0)
        left = source.astype(int)
        share = (source - left).astype(np.float32).reshape(-1, *[1] * (image.ndim - 1))
        return image[left] * (1 - share) + image[np.minimum(left + 1, len(image) - 1)] * share

    return along(along(image, height).T, width).T


def heat_of(logits):
    """Step 3, of [65, h, w]."""
    raised = np.exp(logits - logits.max(0))
    cells = (raised / raised.sum(0))[:64].reshape(8, 8, *logits.shape[1:])
    return cells.transpose(2, 0, 3, 1).reshape(8 * logits.shape[1], -1)


def sampled(planes, points, side, reach, weight):
    """The values of [c, h, w] at points (x, y) px: [n, c]; `reach` neighbours each way, weighed by their distance."""
    total = 0
    places = points * (np.array(planes.shape[:0:-1]) / (np.array(side) - 1)) - 0.5
    first = np.floor(places).astype(int)
    padded = np.pad(planes, ((0, 0), (reach, reach), (reach, reach)))
    for dy in range(1 - reach, reach + 1):
        for dx in range(1 - reach, reach + 1):
            column, row = (first + (dx, dy)).T
            share = weight(np.abs(places[:, 0] - column)) * weight(np.abs(places[:, 1] - row))
            total = total + padded[:, row + reach, column + reach].T * share[:, None]
    return total


def cubic(distance, a=-0.75):
    near = ((a + 2) * distance - (a + 3)) * distance * distance + 1
    return np.where(distance <= 1, near, ((a * distance - 5 * a) * distance + 8 * a) * distance - 4 * a)


def described(graph, image, count=COUNT):
    """The steps from picture to points: points, scores, descriptors."""
    (height, width), side = image.shape, [32 * (length // 32) for length in image.shape[::-1]]
    small = resized(image, *side)
    outputs = graph.run(OUTPUTS, {"image": small[None, None].astype(np.float32)})
    descriptors, logits, reliability = (planes[0] for planes in outputs)
    heat = heat_of(logits)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(heat, WINDOW // 2), (WINDOW, WINDOW)).max((2, 3))
    rows, columns = np.nonzero((heat == around) & (heat > THRESHOLD))
    points = np.stack([columns, rows], 1)
    scores = heat[rows, columns] * sampled(reliability, points, side, 1, lambda distance: 1 - distance)[:, 0]
    scores[(points == np.array(side) - 1).any(1) | (points == 0).all(1)] = 0
    order = [index for index in np.argsort(-scores, kind="stable")[:count] if scores[index] > 0]
    found = sampled(descriptors, points[order], side, 2, cubic)
    found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
    return points[order] * (np.array([width, height]) / side), scores[order], found


def matched(graph, pair):
    """The steps from points to matches, and all scores."""
    feed = {}
    for side, (size, points, descriptors) in zip("ab", pair):
        feed[f"points_{side}"] = ((points - np.array(size) / 2) / (max(size) / 2))[None].astype(np.float32)
        feed[f"descriptors_{side}"] = descriptors[None].astype(np.float32)
    scores = graph.run(None, feed)[0]
    return matcher_check.mutual(scores), scores


def near(found, published, what):
    """Stops where the described steps give something else than the published code."""
    found, published = np.asarray(found), np.asarray(published)
    if found.shape != published.shape or not np.abs(found - published).max() <= TOLERANCE:
        raise SystemExit(f"the described {what} are not the published ones")


def published_points(xfeat, image, count=COUNT):
    found = xfeat.detectAndCompute(torch.from_numpy(image)[None, None], top_k=count)[0]
    return [found[key].numpy() for key in ("keypoints", "scores", "descriptors")]


def published_matches(xfeat, glue, pair):
    """By XFeat.match_lighterglue: indices, their scores, and the matcher's whole answer."""
    answers = []

    def kept(*data, **options):
        answers.append(glue(*data, **options))
        return answers[0]

    # The published method looks for its matcher in a package of another name, unless it has one.
    xfeat.lighterglue = kept
    sides = []
    for size, points, descriptors in pair:
        points, descriptors = (torch.from_numpy(part).float() for part in (points, descriptors))
        sides.append({"keypoints": points, "descriptors": descriptors, "image_size": size})
    _, _, indices = xfeat.match_lighterglue(*sides)
    return indices.tolist(), answers[0]["scores"][0].numpy(), answers[0]


def features(xfeat, graph, entry):
    """Points, scores and descriptors of a picture, rounded; and its entry in the file."""
    values = picture(**entry)
    image = values.astype(np.float32) / np.float32(255)
    found = published_points(xfeat, image, COUNT + 1)
    if not (np.diff(found[1]) < -APART).all():
        raise SystemExit("two scores are all but equal: which point comes first, is chance")
    found = [part[:COUNT] for part in found]
    for what, ours, theirs in zip(("points", "scores", "descriptors"), described(graph, image), found):
        near(ours, theirs, what)
    points, scores, descriptors = (part.astype(float).round(digits) for part, digits in zip(found, (4, 6, 5)))
    listing = {
        **entry, "checksum": int(values.sum()),
        "points": np.column_stack([points, scores]).tolist(), "descriptors": descriptors.tolist(),
    }
    return (entry["size"], points, descriptors), listing


def matches(xfeat, graph, glue, pair):
    """What the file says of a pair."""
    indices, scores, answer = published_matches(xfeat, glue, pair)
    every = answer["log_assignment"][0, :-1, :-1].exp().numpy()
    ours, our_scores = matched(graph, pair)
    near(ours, indices, "matches")
    near(our_scores, every, "scores of matches")
    same, pruned, _ = published_matches(xfeat, LighterGlue(width_confidence=0.95), pair)
    near(same, indices, "matches without pruning")
    return {
        "matches": [[*match, round(float(score), 5)] for match, score in zip(indices, scores)],
        "pruned": [round(float(score), 5) for score in pruned],
        "scores": [[*place, round(float(every[*place]), 6)] for place in [*places(every.shape, 16), *indices[::4]]],
    }


def dense(xfeat, entry):
    """Some of the network's outputs for a picture."""
    image = torch.from_numpy(picture(**entry).astype(np.float32) / np.float32(255))[None, None]
    with torch.inference_mode():
        outputs = matcher_check.outputs(xfeat.net, image)
    return {
        name: [[*place, round(float(planes[0, *place]), 5)] for place in places(planes.shape[1:], 16)]
        for name, planes in zip(OUTPUTS, outputs)
    }


def places(shape, count):
    """Some indices, the same every time."""
    return np.random.default_rng(7).integers(0, shape, (count, len(shape))).tolist()


def main():
    graphs = [matcher_check.session(name, TOP / ".matcher") for name in ("xfeat.onnx", "lighterglue.onnx")]
    xfeat, glue = matcher_check.published()
    pair, pictures = zip(*(features(xfeat, graphs[0], entry) for entry in PICTURES))
    found = matches(xfeat, graphs[1], glue, pair)
    path = TOP / "src" / "core" / "matching" / "reference.json"
    path.write_text(json.dumps({"pictures": pictures, **found, "dense": dense(xfeat, PICTURES[0])}) + "\n")
    moved = np.subtract(*(entry["corner"] for entry in PICTURES))
    off = [np.linalg.norm(pair[0][1][row] + moved - pair[1][1][column]) for row, column, _ in found["matches"]]
    print(f"{path.stat().st_size} bytes, {len(off)} matches, off by {np.median(off):.1f} px (median)")


if __name__ == "__main__":
    main()
