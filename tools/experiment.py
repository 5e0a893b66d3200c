#!/usr/bin/env python3
"""Runs the variants of an experiment on captures with ground truth, several seeds each, and prints one Markdown table.

    python3 tools/experiment.py tools/experiments/parts.json --fled target/release/fled --out /tmp/parts CAPTURE ...

A CAPTURE is a folder or a zip, with options of its own after a colon: `sceaux:held_out=5;size=420`. Options of a run are, the
later over the earlier: the experiment's, those of `--set`, the capture's, the seed, the variant's.

Every run has a record under OUT/runs, named by the hash of all that decides the run: the program, its options, preset and
seed, what the capture and the networks hold, and the machine's adapter and libraries. Only records become rows. So runs
that finished are not done again, an interrupted experiment goes on, and what has changed since is no row.

An experiment is a JSON object:

    question     what it answers
    photographs  "as taken", or "ground truth": the sharp photographs (`gt/` or `HL/`) with their poses, and nothing else
    preset       of every run
    seeds        how many, from 0
    set          {option: value} of every run
    variants     [{"name": ..., "set": {option: value}}]; the first is what the others are compared with. A value "2x" is
                 twice what the run has without the variant. `{option}` in a name stands for the option's value

Python's standard library only.
"""

import argparse
import functools
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import score_table

# Of its doctor's checks: what computes. The disk does not.
COMPUTING = ("adapter", "colmap", "onnxruntime", "models", "matcher")
# Characters of a record's name.
NAME = 16


@dataclass
class Variant:
    """A name, and what it changes."""

    name: str
    options: dict


@dataclass
class Experiment:
    """What an experiment's file says."""

    question: str
    photographs: str
    preset: str
    seeds: int
    options: dict
    variants: list


@dataclass
class Capture:
    """A name for the table, the folder or zip, and its own options."""

    name: str
    path: Path
    options: dict


def as_words(options):
    """Options as `--set` takes them: text."""
    return {key: value if isinstance(value, str) else json.dumps(value) for key, value in options.items()}


def assignments(texts):
    """{key: value} of `key=value` texts."""
    unclear = [text for text in texts if "=" not in text]
    if unclear:
        raise SystemExit(f"no option: {', '.join(unclear)}; key=value is one")
    return dict(text.split("=", 1) for text in texts)


def read_experiment(path):
    """An experiment; whatever is misspelt in its file is an error."""
    content = json.loads(Path(path).read_text())
    expected = {"question", "photographs", "preset", "seeds", "set", "variants"}
    if set(content) != expected:
        raise SystemExit(f"{path}: not an experiment's: {sorted(set(content) ^ expected)}")
    if content["photographs"] not in ("as taken", "ground truth"):
        raise SystemExit(f"{path}: photographs are `as taken` or `ground truth`")
    variants = [Variant(entry["name"], as_words(entry["set"])) for entry in content["variants"]]
    if len({variant.name for variant in variants}) != len(variants):
        raise SystemExit(f"{path}: two variants have one name")
    return Experiment(
        question=content["question"],
        photographs=content["photographs"],
        preset=content["preset"],
        seeds=content["seeds"],
        options=as_words(content["set"]),
        variants=variants,
    )


def read_captures(texts):
    """Captures of the command line."""
    captures = []
    for text in texts:
        path, _, own = text.partition(":")
        if not Path(path).exists():
            raise SystemExit(f"{path} is missing")
        options = assignments([option for option in own.split(";") if option])
        captures.append(Capture(Path(path).name, Path(path), options))
    names = [capture.name for capture in captures]
    if len(set(names)) != len(names):
        raise SystemExit(f"two captures have one name: {', '.join(names)}")
    return captures


def merged(common, changes):
    """Options with a variant's over them; "2x" is twice what there was."""
    options = dict(common)
    for key, value in changes.items():
        times = re.fullmatch(r"(\d+)x", value)
        if times and key not in common:
            raise SystemExit(f"{key}={value}: of what? Give {key} to all variants")
        options[key] = str(int(times[1]) * int(common[key])) if times else value
    return options


def checksum(path):
    """SHA-256 of a file, or of a folder's files with their paths; where it lies and when it was made do not matter."""
    path = Path(path)
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted(file for file in path.rglob("*") if file.is_file())
    listing = [[file.relative_to(path).as_posix(), checksum(file)] for file in files]
    return hashed(listing)


def hashed(value):
    """SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def write_whole(path, text):
    """Writes a file whole or not at all."""
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    partial.write_text(text)
    partial.rename(path)


def ground_truth(capture, out):
    """A capture of the sharp photographs of `capture`, with their poses."""
    folders = [capture.path / name for name in ("gt", "HL") if (capture.path / name).is_dir()]
    if not folders:
        raise SystemExit(f"{capture.path} holds no ground truth: neither gt/ nor HL/")
    with tempfile.TemporaryDirectory(dir=out) as scratch:
        building = Path(scratch) / capture.name
        for name in ("gt", "images"):
            shutil.copytree(folders[0], building / name)
        if (capture.path / "sparse_gt").is_dir():
            shutil.copytree(capture.path / "sparse_gt", building / "sparse")
        else:
            shutil.copy(capture.path / "poses_bounds.npy", building)
        # Under a name of what it holds: a run that was interrupted finds its photographs where they were.
        wanted = checksum(building)
        folder = out / "captures" / wanted[:NAME]
        if not folder.is_dir():
            folder.parent.mkdir(exist_ok=True)
            building.rename(folder)
    if checksum(folder) != wanted:
        raise SystemExit(f"{folder} holds something else than its name says; remove it")
    return Capture(capture.name, folder, capture.options)


class Program:
    """A build of fled on this machine."""

    def __init__(self, path):
        self.path = Path(path).resolve()
        self.checksum = checksum(self.path)

    def asked(self, *words):
        """What the program answers in JSON. The doctor's exit code says whether all is well, which is not asked."""
        command = [self.path, *words, "--json"]
        answer = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
        try:
            return json.loads(answer.stdout)
        except ValueError as error:
            raise SystemExit(f"{' '.join(map(str, command))} answered no JSON: {answer.stdout}") from error

    @functools.cached_property
    def machine(self):
        """What computes here: adapter, COLMAP, ONNX Runtime, and which network is the default."""
        checks = {check["name"]: check["detail"] for check in self.asked("doctor")["checks"]}
        return {name: checks[name] for name in COMPUTING}

    @functools.cached_property
    def known_networks(self):
        """Checksums of the networks that have a name; None where it is not known."""
        return {entry["id"]: entry["sha256"] for entry in self.asked("models", "list")["models"]}

    def networks(self, options):
        """Checksum of every network that an option names, or whose file it names."""
        found = {}
        for key, value in options.items():
            if value in self.known_networks:
                if self.known_networks[value] is None:
                    raise SystemExit(f"{key}={value}: its checksum is not known; name its file instead")
                found[key] = self.known_networks[value]
            elif Path(value).is_file():
                found[key] = checksum(value)
        return found


class Laboratory:
    """The folder of the records, and whoever fills it."""

    def __init__(self, program, out):
        self.program, self.out = program, out
        self.runs = out / "runs"
        self.runs.mkdir(parents=True, exist_ok=True)
        self.checksum = functools.cache(checksum)

    def facts(self, preset, capture, options):
        """All that decides a run."""
        return {
            "program": self.program.checksum,
            "machine": self.program.machine,
            "preset": preset,
            "options": options,
            "capture": self.checksum(capture.path),
            "networks": self.program.networks(options),
        }

    def recorded(self, facts):
        """The report of a run of these facts that has finished, or None."""
        path = self.runs / f"{hashed(facts)[:NAME]}.json"
        if not path.is_file():
            return None
        record = json.loads(path.read_text())
        if record["facts"] != facts:
            raise SystemExit(f"{path} records another run than its name says; remove it")
        return record["report"]

    def run(self, facts, capture):
        """The report of a run of these facts, done now."""
        name = hashed(facts)[:NAME]
        folder = self.runs / name
        # Poses outlive a run, but not the build that found them.
        poses = self.out / "poses" / self.program.checksum[:NAME]
        command = [self.program.path, "run", capture.path, "--out", folder, "--cache", poses]
        command += ["--preset", facts["preset"]]
        for key, value in facts["options"].items():
            command += ["--set", f"{key}={value}"]
        print(" ".join(map(str, command)), file=sys.stderr, flush=True)
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        if done.returncode != 0:
            raise SystemExit(f"the run ended with {done.returncode}; {folder} has its log")
        now = {
            "program": checksum(self.program.path),
            "capture": checksum(capture.path),
            "networks": self.program.networks(facts["options"]),
        }
        changed = [name for name, value in now.items() if facts[name] != value]
        if changed:
            raise SystemExit(f"{' and '.join(changed)} changed while it ran; {folder} is not recorded")
        report = json.loads((folder / "metrics.json").read_text())
        shutil.rmtree(folder / "work", ignore_errors=True)
        write_whole(self.runs / f"{name}.json", json.dumps({"facts": facts, "report": report}, indent=1))
        return report


def results(experiment, captures, laboratory, only_finished=False):
    """{(capture, variant): {seed: report}}; every variant has had a seed before any has its second."""
    found = {}
    for seed in range(experiment.seeds):
        for variant in experiment.variants:
            for capture in captures:
                common = {**experiment.options, **capture.options, "seed": str(seed)}
                options = merged(common, variant.options)
                facts = laboratory.facts(experiment.preset, capture, options)
                report = laboratory.recorded(facts)
                if report is None and not only_finished:
                    report = laboratory.run(facts, capture)
                if report is not None:
                    # Not by the capture's own options: on every capture a variant has one name.
                    name = variant.name.format(**merged(experiment.options, variant.options))
                    found.setdefault((capture.name, name), {})[seed] = report
    return found


def parsed():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiment", type=Path, help="its file")
    parser.add_argument("captures", nargs="+", metavar="CAPTURE")
    parser.add_argument("--fled", type=Path, default=Path("target/release/fled"), help="the program")
    parser.add_argument("--out", type=Path, required=True, help="folder of the records")
    parser.add_argument("--preset", help="in place of the experiment's")
    parser.add_argument("--seeds", type=int, help="in place of the experiment's")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="an option of every run")
    parser.add_argument("--only", action="append", metavar="NAME", help="of a variant to run beside the first; repeatable")
    parser.add_argument("--finished", action="store_true", help="run nothing, print what is finished")
    return parser.parse_args()


def main():
    arguments = parsed()
    experiment = read_experiment(arguments.experiment)
    experiment.preset = arguments.preset or experiment.preset
    experiment.seeds = arguments.seeds or experiment.seeds
    experiment.options |= assignments(arguments.set)
    if arguments.only:
        unknown = set(arguments.only) - {variant.name for variant in experiment.variants}
        if unknown:
            raise SystemExit(f"no such variant: {', '.join(sorted(unknown))}")
        first, *others = experiment.variants
        experiment.variants = [first] + [other for other in others if other.name in arguments.only]
    laboratory = Laboratory(Program(arguments.fled), arguments.out)
    captures = read_captures(arguments.captures)
    if experiment.photographs == "ground truth":
        captures = [ground_truth(capture, arguments.out) for capture in captures]
    found = results(experiment, captures, laboratory, arguments.finished)
    print(f"{experiment.question}\n")
    print(score_table.table(found, brightened=experiment.photographs == "as taken"))


if __name__ == "__main__":
    main()
