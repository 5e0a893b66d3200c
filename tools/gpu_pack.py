"""Packs everything that tools/gpu_check.sh needs on a machine into gpu-check/ at the top of the repository.

    python3 tools/gpu_pack.py

The pack has the program, the kernel tests, ONNX Runtime's library, a small capture with its poses, and the script.
It needs a Vulkan driver, bash and gzip: no Rust, no Python, no network, no repository.
"""

import gzip
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
FOLDER = TOP / "gpu-check"
LIBRARY = TOP / ".onnxruntime" / "libonnxruntime.so"
# Crates whose tests run kernels.
TESTED = ("fled-core", "fled-gpu", "fled-lab")
# Some ways to copy files to such a machine have this limit.
MOST_BYTES = 60_000_000
# Dark, a little shaken, and small; the job only shows that everything runs.
CAPTURE = ("--views", "12", "--size", "320x180", "--blur", "4", "--seed", "1")


def test_executables(lines, crates):
    """Crate -> its unit tests' executable, from the lines of cargo's `--message-format=json`."""
    found = {}
    for line in lines:
        try:
            message = json.loads(line)
        except ValueError:
            continue
        if message.get("reason") != "compiler-artifact" or not message.get("executable"):
            continue
        target = message["target"]
        name = target["name"].replace("_", "-")
        if message["profile"]["test"] and "lib" in target["kind"] and name in crates:
            found[name] = Path(message["executable"])
    missing = [crate for crate in crates if crate not in found]
    if missing:
        raise SystemExit(f"cargo built no tests of {', '.join(missing)}")
    return found


def build():
    """The program and the tests."""
    cargo = os.environ.get("CARGO", "cargo")
    subprocess.run([cargo, "build", "--release", "--locked", "-p", "fled"], cwd=TOP, check=True)
    # The build of `make test`: with `-p`, crates have other features and are built again.
    command = [cargo, "test", "--no-run", "--release", "--locked", "--workspace", "--lib"]
    command.append("--message-format=json")
    output = subprocess.run(command, cwd=TOP, check=True, stdout=subprocess.PIPE, text=True).stdout
    target = Path(os.environ.get("CARGO_TARGET_DIR", TOP / "target"))
    return target / "release" / "fled", test_executables(output.splitlines(), TESTED)


def pack(source, name):
    """A copy without symbols, compressed."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / name
        shutil.copyfile(source, copy)
        # Without binutils the symbols stay.
        if shutil.which("strip"):
            subprocess.run(["strip", "-s", copy], check=True)
        # No time in the header: equal binaries make equal packs.
        with (FOLDER / f"{name}.gz").open("wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
            packed.write(copy.read_bytes())


def size_of(folder):
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def main():
    if not LIBRARY.is_file():
        raise SystemExit(f"{LIBRARY} is missing: run `make onnxruntime`")
    program, tests = build()
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    pack(program, "fled")
    for crate, executable in tests.items():
        pack(executable, f"{crate}-tests")
    pack(LIBRARY, LIBRARY.name)
    shutil.copy(TOP / "tools" / "gpu_check.sh", FOLDER)
    subprocess.run([program, "synth", FOLDER / "capture", *CAPTURE], check=True)
    size = size_of(FOLDER)
    if size > MOST_BYTES:
        raise SystemExit(f"gpu-check/ has {size / 1e6:.1f} MB, at most {MOST_BYTES / 1e6:.0f} can be carried")
    print(f"gpu-check/ has {size / 1e6:.1f} MB: carry it to a machine with a GPU and run gpu_check.sh in it")


if __name__ == "__main__":
    sys.exit(main())
