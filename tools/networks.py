#!/usr/bin/env python3
"""What a deblurring network brings in the loop: runs `fled run` on captures with ground truth without one, with one by itself,
guided and blended, several seeds each, and prints Markdown tables. Python's standard library only.

    python3 tools/networks.py --fled target/release/fled --out /tmp/networks CAPTURE[:key=value;...] ...

Finished runs of the same build of the program and of the same network are not done again, so an interrupted comparison goes on;
COLMAP's poses are kept from build to build.
"""

import argparse
import hashlib
import json
import pathlib
import statistics
import subprocess
import sys

from ablate import run

# The scene is trained on what the network returns, as in the paper; the last rows are what fled does by default.
LOOP = ["rounds=2", "shake=off"]
VARIANTS = [
    ("no network", LOOP + ["deblur=identity"]),
    ("{}, never guided", LOOP + ["guide=none"]),
    ("{}, guided by renders", LOOP),
    ("{}, fed the guide in the view's place", LOOP + ["guide=blend"]),
    ("shake kernels, no network", ["rounds=2", "deblur=identity"]),
    ("shake kernels; {} only made and scored", ["rounds=2"]),
]


def scores(report):
    """Of the last round against ground truth: {(split, image): (psnr_cc dB, SSIM)}, and the renders' sharpness."""
    final = report["rounds"][-1]
    found = {
        (record["split"], record["image"]): (record["psnr_cc_db"], record["ssim"])
        for record in final["records"]
        if (record["reference"], record["brightness"]) == ("gt", "final")
    }
    return {**found, "sharpness": final["sharpness"]["render"]}


def checksum(arguments):
    """Of the network's file, so that another one under its name is not taken for it."""
    path = pathlib.Path(arguments.network)
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    listed = subprocess.run([arguments.fled, "models", "list", "--json"], check=True, capture_output=True, text=True).stdout
    for entry in json.loads(listed)["models"]:
        if entry["id"] == arguments.network:
            return str(entry["sha256"])
    raise SystemExit(f"{arguments.network} is no known network and no file")


def cell(by_seed, key, base=None):
    """Mean and spread over the seeds of a PSNR with its SSIM; the difference is by seed: what seeds share is not noise."""
    base = {} if base is None or base is by_seed else base
    by_seed = {seed: run for seed, run in by_seed.items() if key in run}
    if not by_seed:
        return "-"
    runs = list(by_seed.values())
    psnr = [run[key][0] for run in runs]
    spread = f" ± {statistics.stdev(psnr):.2f}" if len(psnr) > 1 else ""
    text = f"{statistics.mean(psnr):.2f}{spread} / {statistics.mean(run[key][1] for run in runs):.4f}"
    shared = [seed for seed in by_seed if seed in base]
    if shared:
        text += f" ({statistics.mean(by_seed[seed][key][0] - base[seed][key][0] for seed in shared):+.2f})"
    return text


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="+", help="folder, with options after a colon: sceaux:held_out=5")
    parser.add_argument("--fled", type=pathlib.Path, default=pathlib.Path("target/release/fled"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--network", default="small-u2w16", help="what deblur= takes; `default` would be another where CUDA runs it")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], help="an option of every run")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the variants to run, from 0")
    parser.add_argument("--finished", action="store_true", help="run nothing, print what is finished")
    arguments = parser.parse_args()
    results, network_file, build = {}, checksum(arguments), hashlib.sha256(arguments.fled.read_bytes()).hexdigest()
    for seed in range(arguments.seeds):
        for number, (name, options) in enumerate(VARIANTS):
            if arguments.only is not None and number not in arguments.only:
                continue
            for text in arguments.captures:
                path, _, extra = text.partition(":")
                capture = pathlib.Path(path)
                network = [] if any(o.startswith("deblur=") for o in options) else [f"deblur={arguments.network}"]
                every = arguments.set + [o for o in extra.split(";") if o] + [f"seed={seed}"] + options + network
                facts = [str(capture.resolve()), arguments.preset, *every, build, network_file if network else ""]
                slug = hashlib.sha256("\n".join(facts).encode()).hexdigest()[:12]
                out = arguments.out / capture.name / f"{number}-{seed}-{slug}"
                if arguments.finished and not (out / "scene.ply").exists():
                    continue
                results.setdefault((capture.name, name), {})[seed] = scores(run(arguments, capture, out, every))
    for capture in dict.fromkeys(name for name, _ in results):
        print(f"| {capture} | renders, held out, psnr_cc dB / SSIM | deblurred views, all that train | sharpness of the renders | seeds |")
        print("|---|---|---|---|---|")
        base = results.get((capture, VARIANTS[0][0]))
        for name, _ in VARIANTS:
            by_seed = results.get((capture, name))
            if by_seed:
                sharpness = statistics.mean(run["sharpness"] for run in by_seed.values())
                render, deblurred = cell(by_seed, ("held_out", "render"), base), cell(by_seed, ("train", "deblurred"))
                label = name.format(arguments.network)
                print(f"| {label} | {render} | {deblurred} | {sharpness:.0f} | {len(by_seed)} |")
        print()


if __name__ == "__main__":
    sys.exit(main())
