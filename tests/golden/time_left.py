#!/usr/bin/env python3
"""Records twelve small runs for the test of the time left (src/core/pipeline/plan/tests.rs).

`python tests/golden/time_left.py target/release/fled [N...]` writes time_left/N.jsonl: a line of the options, the views and
the pixels, then seconds and events, of those that a plan reads. Seconds are half of those that the run and its COLMAP
compute: on two cores that are not shared they would be about those of the clock, and other work beside hardly changes
them. Needs COLMAP and ONNX Runtime, as every run does, and Linux.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

OUT = Path(__file__).parent / "time_left"
# Views, size, shake in px and options: of different lengths, networks, rounds and sources of poses.
JOBS = [
    (12, "160x120", 9, {"steps": 200, "cap": 5000}),
    (16, "320x180", 9, {"steps": 150, "cap": 3000}),
    (12, "240x136", 9, {"steps": 300, "cap": 2000, "rounds": 1, "deblur": "identity"}),
    (14, "200x112", 9, {"steps": 100, "cap": 4000, "rounds": 3, "deblur": "identity"}),
    (10, "240x136", 9, {"steps": 120, "cap": 3000, "pose_source": "colmap"}),
    (12, "240x136", 0.5, {"steps": 240, "cap": 3000}),
    (8, "320x240", 9, {"steps": 250, "cap": 2000, "rounds": 1}),
    (14, "200x150", 9, {"steps": 200, "cap": 2000, "train_on": "deblurred", "shake": "off"}),
    (12, "240x136", 9, {"steps": 120, "cap": 3000, "shake": "kernel", "deblur": "identity"}),
    (18, "280x158", 9, {"steps": 200, "cap": 8000}),
    # Shaken so much that the search for poses needs four strategies.
    (8, "160x120", 30, {"steps": 120, "cap": 3000, "pose_source": "colmap", "deblur": "identity"}),
    (10, "240x136", 9, {"steps": 120, "cap": 3000, "pose_source": "colmap"}),
]
READ = {"planned", "stage_started", "strategy_started", "stage_advanced", "stage_finished", "round_finished", "finished"}
# Least change of a stage's share that is kept.
STEP = 0.1


def computed(process: int) -> float:
    """Half of the seconds that a process and its ended children have computed."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK") / 2


def reduced(metrics: dict, pace: float) -> dict:
    """Without scores, of which a plan reads only which views are shaken; times in the recording's seconds."""
    views = [
        {"name": "", "registered": True, "split": view["split"], "is_shaken": view["is_shaken"]}
        for view in metrics["views"]
        if view["split"]
    ]
    between = {part: pace * seconds for part, seconds in metrics["between"].items()}
    rate = metrics["steps_per_second"] / pace
    empty = {"records": [], "noise_sigma": {}, "sharpness": {}, "matched": []}
    return metrics | empty | {"views": views, "between": between, "steps_per_second": rate}


def rounded(value):
    if isinstance(value, float):
        return round(value, 3)
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    return [rounded(each) for each in value] if isinstance(value, list) else value


class Recorder:
    """The lines of one run."""

    def __init__(self, header: dict) -> None:
        self.lines = [header]
        self.share = self.began = 0.0
        self.pace = 1.0

    def take(self, at: float, event: dict) -> None:
        kind = event["event"]
        if kind == "stage_started":
            self.share, self.began = 0.0, at
        if kind == "stage_advanced":
            share = event["done"] / event["total"]
            if self.share > 0.0 and abs(share - self.share) < STEP:
                return
            self.share = share
            event.pop("steps_per_second", None)
        if kind == "stage_finished" and event["stage"] == "reconstruct":
            self.pace = (at - self.began) / event["seconds"]
        if kind == "round_finished":
            event["metrics"] = reduced(event["metrics"], self.pace)
        if kind in READ:
            self.lines.append([round(at, 2), rounded(event)])


def record(fled: str, folder: Path, job: tuple, file: Path) -> None:
    views, size, shake, options = job
    capture = folder / "capture"
    made = ["--views", str(views), "--size", size, "--blur", str(shake), "--seed", file.stem]
    subprocess.run([fled, "synth", capture, *made], check=True)
    command = [fled, "run", capture, "--out", folder / "out", "--cache", "none", "--json"]
    for key, value in options.items():
        command += ["--set", f"{key}={value}"]
    width, height = map(int, size.split("x"))
    recorder = Recorder({"options": options, "views": views, "pixels": views * width * height})
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        for line in run.stdout:
            recorder.take(computed(run.pid), json.loads(line))
    assert run.returncode == 0, command
    text = [json.dumps(line, separators=(",", ":")) for line in recorder.lines]
    file.write_text("\n".join(text) + "\n")


def main() -> None:
    OUT.mkdir(exist_ok=True)
    for number in map(int, sys.argv[2:]) if len(sys.argv) > 2 else range(len(JOBS)):
        job = JOBS[number]
        with tempfile.TemporaryDirectory() as folder:
            record(sys.argv[1], Path(folder), job, OUT / f"{number}.jsonl")


main()
