"""Seconds and memory of ONNX deblurring networks, beside a NAFNet of width 32 with random weights in the same run.

    python speed.py ../models/small-u2w16.onnx

Each network and size in a process of its own, with the session's options of the product (all cores, no spinning).
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

SIZES = {"560x320": (320, 560), "1120x640": (640, 1120)}
VIEWS = 24


def nafnet(path, width=32, encoder=(1, 1, 1, 28), middle=1, decoder=(1, 1, 1, 1)):
    """The published NAFNet of GoPro in folded form, three channels, random weights."""
    import torch
    from torch import nn

    import export
    from onnx_graph import value
    from network import Block

    torch.manual_seed(0)
    graph = export.Graph()
    x = graph.convolution("input", "intro", nn.Conv2d(3, width, 3, padding=1))
    skips = []
    for number, count in enumerate(encoder):
        x = graph.blocks(x, f"encoder.{number}", [Block(width, 3) for _ in range(count)])
        skips.append(x)
        x = graph.convolution(x, f"down.{number}", nn.Conv2d(width, 2 * width, 2, stride=2))
        width *= 2
    x = graph.blocks(x, "middle", [Block(width, 3) for _ in range(middle)])
    for number, count in enumerate(decoder):
        up = graph.convolution(x, f"up.{number}", nn.Conv2d(width, 2 * width, 1, bias=False))
        x = graph.op("Add", [graph.shuffle(up), skips.pop()])
        width //= 2
        x = graph.blocks(x, f"decoder.{number}", [Block(width, 3) for _ in range(count)])
    x = graph.convolution(x, "ending", nn.Conv2d(width, 3, 3, padding=1))
    graph.op("Add", [x, "input"], "output")
    model = graph.model("nafnet", [value("input", "n", 3, "h", "w")], [value("output", "n", 3, "h", "w")])
    path.write_bytes(model.SerializeToString())


def held():
    """Most memory that this process has held, MiB. Not `ru_maxrss`: that begins with what the parent held."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def measure(model, height, width, views):
    """Wall and CPU seconds of a view, and the process's peak above what it held before, MiB."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    base = held()
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    channels = session.get_inputs()[0].shape[1]
    view = np.random.default_rng(0).random((1, channels, height, width), np.float32)
    session.run(None, {"input": view})
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(views):
        session.run(None, {"input": view})
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return dict(wall=wall / views, cpu=cpu / views, peak=held() - base)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--one", type=int, nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(str(options.models[0]), *options.one)))
        return
    print("| network | file, MB | size | wall s a view | CPU s a view | 24 views, s | peak above the base, MiB |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        beside = Path(folder) / "nafnet-w32-random.onnx"
        nafnet(beside)
        for model in [*options.models, beside]:
            for name, size in SIZES.items():
                views = VIEWS if model != beside else 3
                command = [sys.executable, __file__, model, "--one", *map(str, (*size, views))]
                result = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                print(
                    f"| {model.stem} | {model.stat().st_size / 1e6:.1f} | {name} | {result['wall']:.3f} | {result['cpu']:.3f} "
                    f"| {VIEWS * result['wall']:.1f} | {result['peak']:.0f} |", flush=True,
                )


if __name__ == "__main__":
    main()
