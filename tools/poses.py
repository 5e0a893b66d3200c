#!/usr/bin/env python3
"""Finds the poses of dark, shaken cells with variants of fled's fallback strategies, and prints a Markdown table.

    python3 tools/poses.py --fled target/release/fled --sharp SHARP --out OUT CELL ...

A CELL is a folder with `images/`, some of the photographs of the set SHARP/<name>, made dark and shaken, and a
`degrade.json` that names the set. A pose is good within 3 % of the extent (the largest distance of two true cameras)
and 3 degrees, wrong beyond 6 % or 6 degrees, after the similarity that makes most of them good. Views that fled leaves
out as doubtful have no pose; a wrong one is without a warning where the poses are not called of low confidence.

Every run has a record under OUT, named by the cell, the variant and the program; what has a record is not run again.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pose_errors

# Name of a variant, and its arguments besides the common ones.
VARIANTS = {"COLMAP's features": ["--matcher", "none"], "learned features": []}


def run(fled, cell, arguments, folder, seconds):
    """The content of poses.json, or None; the wall seconds; the log."""
    shutil.rmtree(folder, ignore_errors=True)
    start = time.monotonic()
    command = [fled, "poses", cell, "--out", folder, "--cache", "none", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=seconds)
        log = done.stderr
    except subprocess.TimeoutExpired as expired:
        log = f"{expired.stderr or ''}\nno end after {seconds} s"
    took = time.monotonic() - start
    path = folder / "poses.json"
    return (json.loads(path.read_text()) if path.is_file() else None), took, str(log)


def score(poses, true, images):
    """The figures of one run."""
    if poses is None:
        return {"photographs": images, "registered": 0, "good": 0, "wrong": 0, "unwarned": 0, "rms": None}
    errors = pose_errors.judged(pose_errors.of_fled(poses), true)
    wrong = {name for name, error in errors.items() if pose_errors.is_wrong(error)}
    unwarned = set() if poses["low_confidence"] else wrong
    good = [away for away, turn in errors.values() if pose_errors.is_good((away, turn))]
    return {
        "photographs": images,
        "registered": len(errors),
        "good": len(good),
        "wrong": len(wrong),
        "unwarned": len(unwarned),
        "rung": poses["rung"],
        "low_confidence": poses["low_confidence"],
        "rms": (sum(away * away for away in good) / len(good)) ** 0.5 if good else None,
        "errors": {name: [round(value, 4) for value in error] for name, error in errors.items()},
    }


def record(arguments, cell, variant, program):
    """The figures of a cell and a variant, from disk or from a new run."""
    name = f"{cell.name}-{variant.split()[0].lower().replace(chr(39), '')}-{program}"
    path = arguments.out / f"{name}.json"
    if path.is_file():
        return json.loads(path.read_text())
    degrade = json.loads((cell / "degrade.json").read_text())
    images = sorted(file.stem for file in (cell / "images").iterdir())
    true = pose_errors.of_colmap_text(arguments.sharp / degrade["sharp"] / "sparse" / "images.txt")
    true = {name: camera for name, camera in true.items() if name in images}
    poses, seconds, log = run(arguments.fled, cell, VARIANTS[variant], arguments.out / name, arguments.seconds)
    figures = score(poses, true, len(images)) | {"seconds": round(seconds, 1), "cell": cell.name, "variant": variant}
    (arguments.out / f"{name}.log").write_text(log)
    if not arguments.keep_work:
        shutil.rmtree(arguments.out / name / "work", ignore_errors=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(figures, indent=1))
    partial.rename(path)
    return figures


def cell_text(figures):
    if figures is None:
        return "-"
    doubt = ", not trusted" if figures.get("low_confidence") else ""
    rms = "" if figures["rms"] is None else f" ({100 * figures['rms']:.2f} %)"
    text = f"{figures['good']} good{rms}, {figures['wrong']} wrong"
    if figures["unwarned"]:
        text += f" ({figures['unwarned']} without a warning)"
    return f"{text}, strategy {figures.get('rung') or '-'}{doubt}, {figures['seconds']:.0f} s"


def table(rows, variants):
    """A Markdown table with a row per cell."""
    lines = [f"| cell | photographs | {' | '.join(variants)} |", f"|---|---|{'---|' * len(variants)}"]
    for cell, by_variant in rows.items():
        count = next(iter(by_variant.values()))["photographs"]
        texts = [cell_text(by_variant.get(variant)) for variant in variants]
        lines.append(f"| {cell} | {count} | {' | '.join(texts)} |")
    totals = []
    for variant in variants:
        found = [by_variant[variant] for by_variant in rows.values() if variant in by_variant]
        sums = {key: sum(figures[key] for figures in found) for key in ("good", "wrong", "unwarned", "seconds")}
        totals.append("{good} good, {wrong} wrong ({unwarned} without a warning), {seconds:.0f} s".format(**sums))
    photographs = sum(next(iter(by_variant.values()))["photographs"] for by_variant in rows.values())
    lines.append(f"| all {len(rows)} | {photographs} | {' | '.join(totals)} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cells", type=Path, nargs="+", metavar="CELL")
    parser.add_argument("--fled", type=Path, required=True)
    parser.add_argument("--sharp", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--seconds", type=int, default=900, help="that a run may take")
    parser.add_argument("--keep-work", action="store_true", help="what COLMAP was given and what it wrote")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    program = hashlib.sha256(arguments.fled.read_bytes()).hexdigest()[:8]
    rows = {}
    for cell in arguments.cells:
        rows[cell.name] = {}
        for variant in arguments.variants:
            figures = record(arguments, cell, variant, program)
            rows[cell.name][variant] = figures
            print(f"{cell.name}, {variant}: {cell_text(figures)}", file=sys.stderr, flush=True)
    print(table(rows, arguments.variants))


if __name__ == "__main__":
    main()
