#!/usr/bin/env python3
"""What each part of the method brings: runs `fled run` on captures with ground truth in several variants and
prints Markdown tables of held-out scores at the target brightness, colour-fitted. Python's standard library only.

    python3 tools/compare.py --fled target/release/fled --out /tmp/compare CAPTURE[:key=value;...] ...

Finished runs are not done again, so an interrupted comparison goes on.
"""

import argparse
import json
import pathlib
import subprocess
import sys

# Name and options of each variant; the first is plain 3DGS on the brightened photographs, as published.
PLAIN = ["rounds=1", "deblur=identity", "noise=off", "shake=off", "refine_poses=false"]
VARIANTS = [
    ("plain 3DGS on the brightened photographs", PLAIN + ["background=black"]),
    ("+ changing background", PLAIN),
    ("+ corrected cameras", PLAIN[:-1] + ["refine_poses=true"]),
    ("+ noise field", ["rounds=1", "deblur=identity", "noise=grid", "shake=off"]),
    ("+ deblurring network", ["rounds=1", "noise=off", "shake=off"]),
    ("+ shake kernels", ["rounds=1", "deblur=identity", "noise=off", "shake=kernel"]),
    ("+ all three", ["rounds=1", "train_on=deblurred"]),
    ("2 rounds, trained on deblurred views", ["rounds=2", "train_on=deblurred"]),
    ("2 rounds, trained on deblurred views, no shake kernels", ["rounds=2", "shake=off"]),
    ("2 rounds (fled)", ["rounds=2"]),
]


def held_out(report, image):
    """The last round's held-out record of `image` against ground truth."""
    for record in report["rounds"][-1]["records"]:
        if (record["split"], record["image"], record["reference"]) == ("held_out", image, "gt"):
            return record
    raise SystemExit("a run has no held-out views with ground truth")


def run(arguments, capture, extra, variant, options):
    """The report of one variant on one capture."""
    slug = "".join(c if c.isalnum() else "-" for c in variant)
    out = arguments.out / capture.name / slug
    command = [arguments.fled, "run", capture, "--out", out, "--preset", arguments.preset]
    command += ["--cache", arguments.out / "cache"]
    for option in arguments.set + extra + options:
        command += ["--set", option]
    print(" ".join(map(str, command)), file=sys.stderr, flush=True)
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return json.loads((out / "metrics.json").read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", help="folder, with options after a colon: sceaux:held_out=5")
    parser.add_argument("--fled", type=pathlib.Path, default=pathlib.Path("target/release/fled"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--set", action="append", default=[], help="an option of every run")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the variants to run, from 0")
    arguments = parser.parse_args()
    variants = [v for i, v in enumerate(VARIANTS) if arguments.only is None or i in arguments.only]
    rows, names = {}, []
    for text in arguments.captures:
        folder, _, extra = text.partition(":")
        capture = pathlib.Path(folder)
        names.append(capture.name)
        for variant, options in variants:
            report = run(arguments, capture, [o for o in extra.split(";") if o], variant, options)
            enhanced, render = held_out(report, "enhanced"), held_out(report, "render")
            rows.setdefault("brightened photographs, no 3D", {})[capture.name] = enhanced
            rows.setdefault(variant, {})[capture.name] = {
                **render,
                "steps_per_second": report["rounds"][-1]["steps_per_second"],
                "best": report["best_round"],
            }
    print("| held out, against ground truth | " + " | ".join(f"{n}: psnr_cc dB / SSIM" for n in names) + " | mean |")
    print("|---|" + "---|" * (len(names) + 1))
    for variant, cells in rows.items():
        scores = [(cells[n]["psnr_cc_db"], cells[n]["ssim"]) for n in names]
        scores.append(tuple(sum(column) / len(column) for column in zip(*scores)))
        print(f"| {variant} | " + " | ".join(f"{psnr:.2f} / {ssim:.4f}" for psnr, ssim in scores) + " |")


if __name__ == "__main__":
    main()
