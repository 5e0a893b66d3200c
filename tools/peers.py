#!/usr/bin/env python3
"""Checks scenes independently: other programs read scene.ply and exports, and the published formulas render it.

    make test-peers

Installs splat-transform, three.js, Spark and playwright-core under .peers/, makes a small capture, trains it for 200 steps, and
has two scenes judged: the trained one, and a made-up one that asks more (training/strange.py). Exits with 1 and says why
when a judge disagrees.
"""

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import formats
import numpy as np
import plyfile
from PIL import Image

TOP = Path(__file__).resolve().parent.parent
FOLDER, TRAINING = TOP / ".peers", TOP / "training"
READER = TOP / "tools" / "peers.mjs"
PAINTER = TOP / "tools" / "three_pictures.mjs"
LIBRARY = TOP / ".onnxruntime" / "libonnxruntime.so"
# The newest version that runs on Node 18, the version of Debian 12.
SPLAT_TRANSFORM = "@playcanvas/splat-transform@2.7.1"
THREE = "three@0.187.0"
SPARK = "@sparkjsdev/spark@2.2.0"
# That of the browser tests.
PLAYWRIGHT = "playwright-core@1.65.1"
SYNTH = ["--views", "12", "--size", "256x144", "--seed", "3", "--exposure", "0.5", "--blur", "2", "--noise", "0.005"]
OPTIONS = ["steps=200", "rounds=1", "deblur=identity", "noise=off", "shake=off", "pose_source=given"]
# Tolerance of a compressed scene: a step of an opacity, half a step of a harmonic. The bounds of the rest are exact.
SLACK = {"opacity": 0.004, "f_rest_": 0.0157}
# The largest differences that formats and readers make; colours and harmonics in three are bytes. Harmonics in SOG are
# those of a palette: too few for the random ones of the made-up scene, which differ by up to 0.43.
SPZ = {"position": 1e-6, "size": 0.032, "shape": 0.06, "colour": 0.006, "opacity": 0.003, "harmonics": 0.063}
TOLERANCES = {
    "scene.glb": {"position": 1e-5, "size": 0.01, "shape": 0.01, "colour": 0.003, "opacity": 0.003, "harmonics": 0.006},
    "scene.usda": {"position": 1e-6, "size": 1e-5, "shape": 1e-6, "colour": 1e-6, "opacity": 1e-6, "harmonics": 1e-6},
    "scene.v3.spz": SPZ,
    "scene.spz": SPZ,
    "scene.sog": {"position": 1e-4, "size": 0.06, "shape": 0.05, "colour": 0.01, "opacity": 0.003, "harmonics": 0.5},
}
# dB of a trained scene's pictures after the rounding of a format.
ROUNDED_LEAST = 35
# three.js rounds the colours of a PLY to half of 1/255.
MESH = {"position": 0, "normal": 0, "colour": 0.002}
# The summary has six digits or six decimals: half of the last one, relative and absolute.
ROUNDING = 5.1e-6, 5.1e-7


def run(command, log=None, **options):
    """Runs a command; exits with the end of its output if it fails."""
    command = [str(word) for word in command]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options)
    text = done.stdout.decode(errors="replace")
    if log:
        log.write_text(text)
    if done.returncode != 0:
        last = "\n".join(text.splitlines()[-20:])
        raise SystemExit(f"{' '.join(command)}\nfailed with {done.returncode}:\n{last}")
    return text


def said(*words):
    print(*words, flush=True)


def install_programs():
    """Installs them from npm, without their install scripts: they fetch a WebGPU library that reading does not use."""
    folder, packages = FOLDER / "npm", [SPLAT_TRANSFORM, THREE, SPARK, PLAYWRIGHT]
    stamp, program = folder / "installed", folder / "node_modules" / ".bin" / "splat-transform"
    if not (stamp.is_file() and stamp.read_text() == "\n".join(packages)):
        if not shutil.which("npm"):
            raise SystemExit("npm is missing: run `apt-get install nodejs npm` as root, then again")
        said(f"installing {', '.join(packages)} from npm into .peers/npm")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        run(["npm", "install", "--prefix", folder, "--ignore-scripts", "--no-audit", "--no-fund", *packages])
        stamp.write_text("\n".join(packages))
    return program


def train(fled):
    """The folder of a new run with a scene of a few thousand Gaussians, and the run's report."""
    capture, out = FOLDER / "capture", FOLDER / "trained"
    for folder in (capture, out):
        shutil.rmtree(folder, ignore_errors=True)
    run([fled, "synth", capture, *SYNTH])
    sets = [word for option in OPTIONS for word in ("--set", option)]
    run([fled, "run", capture, "--out", out, "--preset", "preview", "--cache", "none", *sets], FOLDER / "train.log")
    metrics = json.loads((out / "metrics.json").read_text())
    (delivered,) = [r for r in metrics["rounds"] if r["round"] == metrics["best_round"]]
    return out, delivered["gaussians"]


def render(fled, folder):
    """Pictures by `fled render` at three cameras: the first, the middle, the last."""
    pictures = folder.with_name(folder.name + "-pictures")
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir()
    names = [camera["name"] for camera in json.loads((folder / "cameras.json").read_text())]
    for name in (names[0], names[len(names) // 2], names[-1]):
        run([fled, "render", folder, "--view", name, "-o", pictures / f"{name}.png"])
    return pictures


def own_bounds(path):
    """The number of vertices of our PLY, and each property's bounds, in the units of splat-transform."""
    vertices = plyfile.PlyData.read(path)["vertex"].data
    bounds = {}
    for name in vertices.dtype.names:
        ends = vertices[name].min(), vertices[name].max()
        bounds[name] = tuple(sorted(shown(name, float(value)) for value in ends))
    return len(vertices), bounds


def shown(name, value):
    """A stored value decoded: opacities are logits, scales logarithms, colours harmonics of degree 0."""
    if name == "opacity":
        return 1 / (1 + math.exp(-value))
    if name.startswith("scale_"):
        return math.exp(value)
    if name.startswith("f_dc_"):
        return 0.5 + value / math.sqrt(4 * math.pi)
    return value


def read_summary(text):
    """Count, and (least, greatest, NaNs and infinities) of each column, from splat-transform's summary."""
    count = re.search(r"\*\*Row Count:\*\* (\d+)", text)
    if not count:
        raise SystemExit(f"splat-transform says nothing of a count:\n{text}")
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    titles = table[0]
    rows = [dict(zip(titles, row)) for row in table[1:]]
    columns = {r["Column"]: (float(r["min"]), float(r["max"]), int(r["nans"]) + int(r["infs"])) for r in rows}
    return int(count[1]), columns


def objections(theirs, count, bounds, slack=()):
    """Differences of a summary from a count and bounds, one per line; a property may have a tolerance."""
    their_count, columns = theirs
    lines = [] if their_count == count else [f"{their_count} Gaussians, we count {count}"]
    if list(columns) != list(bounds):
        lines.append(f"the properties {list(columns)}, ours are {list(bounds)}")
    for name in filter(bounds.get, columns):
        *pair, poisoned = columns[name]
        if poisoned:
            lines.append(f"{name}: {poisoned} values are no numbers")
        share, number = ROUNDING
        number += max((slack[start] for start in slack if name.startswith(start)), default=0)
        if any(abs(a - b) > share * abs(b) + number for a, b in zip(pair, bounds[name])):
            lines.append(f"{name}: from {pair[0]} to {pair[1]}, ours from {bounds[name][0]} to {bounds[name][1]}")
    return lines


def judge_by_splat_transform(program, folder, count):
    """Compares count and bounds read by splat-transform with the run's count and the file's numbers."""
    scene = folder / "scene.ply"
    in_file, bounds = own_bounds(scene)
    if in_file != count:
        raise SystemExit(f"{scene} has {in_file} Gaussians, the run says {count}")
    theirs = read_summary(run([program, scene, "--summary", "null"]))
    wrong = objections(theirs, count, bounds)
    if wrong:
        raise SystemExit(f"splat-transform reads {scene} otherwise:\n  " + "\n  ".join(wrong))
    corners = ", ".join(f"{axis} {theirs[1][axis][0]:.3f} to {theirs[1][axis][1]:.3f}" for axis in "xyz")
    said(f"splat-transform: {theirs[0]} Gaussians, {len(bounds)} properties agree; {corners}")


def judge_compressed(program, fled, folder, count):
    """Compares the compressed scene read by splat-transform with the numbers of the scene."""
    small = folder.with_name(folder.name + ".compressed.ply")
    run([fled, "export", folder, "scene.compressed.ply", "-o", small])
    bounds = {}
    for name, ends in own_bounds(folder / "scene.ply")[1].items():
        # Normals have no meaning, and a quaternion and its negative are the same rotation.
        if not name.startswith(("n", "rot_")):
            most = 4 if name.startswith("f_rest_") else math.inf
            bounds[name] = tuple(max(-most, min(most, end)) for end in ends)
    their_count, columns = read_summary(run([program, small, "--summary", "null"]))
    theirs = their_count, {name: columns[name] for name in bounds if name in columns}
    wrong = objections(theirs, count, bounds, SLACK)
    if wrong:
        raise SystemExit(f"splat-transform reads {small} otherwise than scene.ply:\n  " + "\n  ".join(wrong))
    share = small.stat().st_size / (folder / "scene.ply").stat().st_size
    said(f"splat-transform: compressed to {share:.0%}, {len(bounds)} properties agree")


def judge_by_three(fled, folder, name):
    """Compares an export read by three.js with the numbers of the scene."""
    file = folder.with_name(f"{folder.name}.{name}")
    run([fled, "export", folder, name, "-o", file])
    theirs, _ = of_three(file)
    judged("three.js", file, name, formats.y_up(formats.of_ply(folder / "scene.ply")), theirs)


def judge_converted(program, folder, name, ours):
    """Compares an export read by splat-transform with our numbers in its order.

    This version of splat-transform turns SPZ back to the axes of PLY files, as the format says; 3.7.0 does not.
    """
    file = folder.with_name(f"{folder.name}.{name}")
    read = file.with_name(file.name + ".read.ply")
    run([program, "--overwrite", file, read])
    judged("splat-transform", file, name, ours, formats.of_ply(read))


def judge_rounded(program, fled, folder, name, pictures):
    """Compares pictures of an export as splat-transform reads it with those of the scene."""
    read = folder.with_name(f"{folder.name}.{name}.read")
    read.mkdir(exist_ok=True)
    run([program, "--overwrite", folder.with_name(f"{folder.name}.{name}"), read / "scene.ply"])
    shutil.copy(folder / "cameras.json", read)
    theirs = render(fled, read)
    worst = min(psnr(theirs / picture.name, picture) for picture in pictures.iterdir())
    if worst < ROUNDED_LEAST:
        raise SystemExit(f"{name} as splat-transform reads it is {worst:.1f} dB from the scene's pictures")
    said(f"splat-transform: {name} as it reads it is at least {worst:.1f} dB from the scene's pictures")


def psnr(*paths):
    """PSNR between two pictures, dB."""
    first, second = (np.asarray(Image.open(path).convert("RGB"), float) / 255 for path in paths)
    return -10 * math.log10(max(((first - second) ** 2).mean(), 1e-12))


def judge_by_spark(folder):
    """Compares exports that are there already, as Spark reads them, with the numbers of the scene but the harmonics."""
    ours, names = formats.of_ply(folder / "scene.ply"), ("scene.v3.spz", "scene.sog", "scene.spz")
    files = [folder.with_name(f"{folder.name}.{name}") for name in names]
    text = subprocess.run(["node", TOP / "tools" / "spark.mjs", FOLDER / "npm", *files], stdout=subprocess.PIPE, check=True).stdout
    *read, refused = json.loads(text)
    for name, file, rows, own in zip(names, files, read, (formats.y_up(ours), formats.along_curve(ours))):
        judged("Spark", file, name, own, formats.of_spark(rows, own), but=("harmonics",))
    if not isinstance(refused, str):
        raise SystemExit("Spark reads scene.spz of version 4: docs/exports.md says otherwise")
    said(f"Spark refuses scene.spz, which is of version 4: {refused}")


def judge_pictures_of_three(folder, names):
    """Compares three.js' pictures of the scene.glb that is there already with the published formulas."""
    pictures = folder.with_name(folder.name + "-three")
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir()
    run(["node", PAINTER, FOLDER / "npm", folder.with_name(f"{folder.name}.scene.glb"), folder / "cameras.json", pictures, *names])
    said(run([sys.executable, TRAINING / "judge_three.py", folder, pictures]).rstrip())


def judge_usd(fled, folder):
    """Compares the USD file read by usd-core, as attributes of its schema, with the numbers of the scene."""
    file = folder.with_name(f"{folder.name}.scene.usda")
    run([fled, "export", folder, "scene.usda", "-o", file])
    theirs, _ = formats.of_usd(file)
    judged("usd-core", file, "scene.usda", formats.y_up(formats.of_ply(folder / "scene.ply")), theirs)


def judge_nodes(fled, folder):
    """Compares the nodes read by three.js and usd-core with each other, and has them level the cameras, at a scale of 2.5."""
    cameras, nodes = json.loads((folder / "cameras.json").read_text()), []
    for name, reader in (("scene.glb", of_three), ("scene.usda", formats.of_usd)):
        file = folder.with_name(f"{folder.name}.scaled.{name}")
        run([fled, "export", folder, name, "--scale", 2.5, "-o", file])
        nodes.append(reader(file)[1])
    linear = nodes[0][:3, :3] / 2.5
    apart, tilt = abs(nodes[0] - nodes[1]).max(), formats.tilt(nodes[0], cameras)
    if nodes[0][:3, 3].any():
        raise SystemExit(f"three.js reads the translation {nodes[0][:3, 3]}, scene.ply has no offset")
    if not (apart < 1e-6 and abs(linear @ linear.T - np.eye(3)).max() < 1e-6 and np.linalg.det(linear) > 0 and tilt < 1):
        raise SystemExit(f"three.js and usd-core read the nodes\n{nodes[0]}\n{nodes[1]}\nwith which cameras are {tilt} degrees from level")
    said(f"three.js, usd-core: the same node, apart by {apart:.1g}; cameras are {tilt:.2f} degrees from level in it")


def of_three(file):
    """The Gaussians that three.js reads in a file, and the matrix of their node."""
    text = subprocess.run(["node", READER, FOLDER / "npm", file], stdout=subprocess.PIPE, check=True).stdout
    return formats.of_three(text)


def judge_mesh(fled, folder):
    """Compares the mesh as three.js reads its two files with plyfile's numbers, and looks for faults in it."""
    ours = None
    for name in ("mesh.ply", "mesh.glb"):
        file = folder.with_name(f"{folder.name}.{name}")
        facts = run([fled, "export", folder, name, "--triangles", 20_000, "-o", file]).strip()
        ours = ours or formats.of_mesh_ply(file)
        text = subprocess.run(["node", READER, FOLDER / "npm", file], stdout=subprocess.PIPE, check=True).stdout
        theirs, expected = formats.of_three_mesh(text), ours if name.endswith(".ply") else formats.mesh_turned(ours)
        if theirs["triangles"].tolist() != expected["triangles"].tolist():
            raise SystemExit(f"three.js reads other triangles in {file}")
        apart = {part: float(abs(theirs[part] - expected[part]).max()) for part in ("position", "normal", "colour")}
        faults = formats.mesh_faults(theirs) + [part for part, value in apart.items() if not value <= MESH[part]]
        if faults:
            raise SystemExit(f"three.js reads {file} otherwise, or it has faults: {faults}, {apart}")
        said(f"three.js: {name} of {file.stat().st_size} bytes is as plyfile reads it; {facts}")


def judged(who, file, name, ours, theirs, but=()):
    """Says how far apart both are but for some parts, and fails if that is too far."""
    apart = {part: value for part, value in formats.differences(ours, theirs).items() if part not in but}
    far = [part for part, value in apart.items() if not value <= TOLERANCES[name][part]]
    shown = ", ".join(f"{part} {value:.2g}" for part, value in apart.items())
    if far:
        raise SystemExit(f"{who} reads {file} otherwise: {shown}")
    said(f"{who}: {name} of {file.stat().st_size} bytes, apart by {shown}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fled", type=Path, default=TOP / "target" / "release" / "fled")
    options = parser.parse_args()
    fled = options.fled.resolve()
    if not fled.is_file():
        raise SystemExit(f"{fled} is missing: make build")
    os.environ.setdefault("ORT_DYLIB_PATH", str(LIBRARY))
    FOLDER.mkdir(exist_ok=True)
    program = install_programs()
    said("a scene of 200 steps")
    trained, count = train(fled)
    strange = FOLDER / "strange"
    made = int(run([sys.executable, TRAINING / "strange.py", strange]))
    for folder, expected in ((trained, count), (strange, made)):
        said(f"\n{folder.name}")
        pictures = render(fled, folder)
        judge_by_splat_transform(program, folder, expected)
        judge_compressed(program, fled, folder, expected)
        judge_by_three(fled, folder, "scene.glb")
        judge_pictures_of_three(folder, [picture.stem for picture in sorted(pictures.iterdir())])
        judge_usd(fled, folder)
        judge_nodes(fled, folder)
        if folder == trained:
            judge_mesh(fled, folder)
        for name in ("scene.v3.spz", "scene.spz"):
            judge_by_three(fled, folder, name)
            judge_converted(program, folder, name, formats.of_ply(folder / "scene.ply"))
        run([fled, "export", folder, "scene.sog", "-o", folder.with_name(f"{folder.name}.scene.sog")])
        judge_converted(program, folder, "scene.sog", formats.along_curve(formats.of_ply(folder / "scene.ply")))
        judge_by_spark(folder)
        if folder == trained:
            for name in ("compressed.ply", "scene.v3.spz", "scene.spz", "scene.sog"):
                judge_rounded(program, fled, folder, name, pictures)
        said(run([sys.executable, TRAINING / "judge.py", folder, pictures]).rstrip())


if __name__ == "__main__":
    main()
