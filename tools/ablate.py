#!/usr/bin/env python3
"""What each choice of the trainer is worth: changes one option at a time on sharp photographs with given poses, several
seeds each, and prints a Markdown table. Python's standard library only.

    python3 tools/ablate.py --fled target/release/fled --out /tmp/ablate CAPTURE[:key=value;...] ...

A capture has its sharp photographs in `gt/` or `HL/` and their poses in `sparse_gt/` or `poses_bounds.npy`; what else it holds
is not used. Finished runs are not done again, so an interrupted comparison goes on.
"""

import argparse
import json
import pathlib
import shutil
import statistics
import subprocess
import sys

# Splats alone: no brightening, no network, no noise field, no shake, the cameras as they are.
BASE = ["rounds=1", "deblur=identity", "noise=off", "shake=off", "refine_poses=false", "pose_source=given", "target=0.1,1"]
# TWICE stands for twice the steps of a run.
VARIANTS = [
    ("as fled is", []),
    ("densify=classic", ["densify=classic"]),
    ("densify=off", ["densify=off"]),
    ("background=black", ["background=black"]),
    ("dropout=0.1", ["dropout=0.1"]),
    ("sh_degree=0", ["sh_degree=0"]),
    ("sh_degree=1", ["sh_degree=1"]),
    ("sh_degree=3", ["sh_degree=3"]),
    ("resolution_schedule=false", ["resolution_schedule=false"]),
    ("fill_up=5000", ["fill_up=5000"]),
    ("view_colour=true", ["view_colour=true"]),
    ("refine_poses=true", ["refine_poses=true"]),
    ("rounds=2 start=warm", ["rounds=2", "start=warm"]),
    ("rounds=2 start=scratch", ["rounds=2", "start=scratch"]),
    ("twice the steps", ["steps=TWICE"]),
]


def sharp(capture, folder):
    """A capture of the sharp photographs of `capture` in `folder`."""
    if (folder / "images").is_dir():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    truth = next(capture / name for name in ("gt", "HL") if (capture / name).is_dir())
    shutil.copytree(truth, folder / "gt", dirs_exist_ok=True)
    if (capture / "sparse_gt").is_dir():
        shutil.copytree(capture / "sparse_gt", folder / "sparse", dirs_exist_ok=True)
    else:
        shutil.copy(capture / "poses_bounds.npy", folder)
    shutil.copytree(truth, folder / "images")
    return folder


def run(arguments, capture, out, options):
    """The report of one run."""
    report = out / "metrics.json"
    # The report is written after every round; the scene is delivered at the end.
    if not (out / "scene.ply").exists():
        command = [arguments.fled.resolve(), "run", capture, "--out", out, "--preset", arguments.preset]
        command += ["--cache", arguments.out / "cache"]
        for option in options:
            command += ["--set", option]
        print(" ".join(map(str, command)), file=sys.stderr, flush=True)
        subprocess.run(command, check=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        shutil.rmtree(out / "work", ignore_errors=True)
    return json.loads(report.read_text())


def last_round(report):
    """Scores of the last round's renders by split, its Gaussians, and the seconds that all rounds trained."""
    final = report["rounds"][-1]
    scores = {}
    for record in final["records"]:
        if (record["image"], record["reference"]) == ("render", "gt"):
            scores[record["split"]] = (record["psnr_cc_db"], record["ssim"])
    steps = report["config"]["steps"]
    seconds = sum(steps / entry["steps_per_second"] for entry in report["rounds"])
    return {"held_out": scores["held_out"], "train": scores["train"], "gaussians": final["gaussians"], "seconds": seconds}


def cell(by_seed, base):
    """One row of the table from results by seed: means, and the spread of the held-out PSNR."""
    runs, mean = list(by_seed.values()), statistics.mean
    held_out = [r["held_out"][0] for r in runs]
    spread = f" ± {statistics.stdev(held_out):.2f}" if len(runs) > 1 else ""
    text = f"{mean(held_out):.2f}{spread} / {mean(r['held_out'][1] for r in runs):.4f}"
    if base is not by_seed:
        # By seed: what the seeds share is not noise.
        text += f" ({mean(r['held_out'][0] - base[seed]['held_out'][0] for seed, r in by_seed.items()):+.2f})"
    gap = mean(r["train"][0] for r in runs) - mean(held_out)
    return f"{text} | {gap:.1f} | {mean(r['gaussians'] for r in runs):.0f} | {mean(r['seconds'] for r in runs):.0f} | {len(runs)}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", help="folder, with options after a colon: sceaux:held_out=5")
    parser.add_argument("--fled", type=pathlib.Path, default=pathlib.Path("target/release/fled"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--preset", default="preview")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--set", action="append", default=[], help="an option of every run")
    parser.add_argument("--finished", action="store_true", help="run nothing, print what is finished")
    parser.add_argument("--only", nargs="*", help="names of the variants to run; the first is always run")
    arguments = parser.parse_args()
    variants = [v for v in VARIANTS if not arguments.only or v[0] in arguments.only or v is VARIANTS[0]]
    results = {}
    for seed in range(arguments.seeds):
        for name, options in variants:
            for text in arguments.captures:
                path, _, extra = text.partition(":")
                capture = sharp(pathlib.Path(path), arguments.out / "captures" / pathlib.Path(path).name)
                slug = "".join(c if c.isalnum() else "-" for c in name)
                out = arguments.out / capture.name / f"{slug}-{seed}"
                steps = [f"steps={arguments.steps}", f"seed={seed}"]
                every = BASE + arguments.set + [o for o in extra.split(";") if o] + steps
                every += [option.replace("TWICE", str(2 * arguments.steps)) for option in options]
                if arguments.finished and not (out / "scene.ply").exists():
                    continue
                found = last_round(run(arguments, capture, out, every))
                results.setdefault((capture.name, name), {})[seed] = found
    for capture in dict.fromkeys(name for name, _ in results):
        print(f"| {capture} | held out, psnr_cc dB / SSIM (difference) | training views, dB above | Gaussians | s | seeds |")
        print("|---|---|---|---|---|---|")
        base = results[capture, VARIANTS[0][0]]
        for name, _ in variants:
            if (capture, name) in results:
                print(f"| {name} | {cell(results[capture, name], base)} |")
        print()


if __name__ == "__main__":
    main()
