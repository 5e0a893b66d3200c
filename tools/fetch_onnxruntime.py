"""Puts the ONNX Runtime library into .onnxruntime/ at the top of the repository.

    python3 tools/fetch_onnxruntime.py

The library comes out of the PyPI wheel, whose checksum is pinned here. Every wheel of a version carries the same
library whatever Python it is for, so one tag is enough. Does nothing when the library is already there.
"""

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

VERSION = "1.31.1"
WHEELS = {
    "x86_64": "5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f",
    "aarch64": "da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3",
}
FOLDER = Path(__file__).resolve().parent.parent / ".onnxruntime"
LIBRARY = FOLDER / "libonnxruntime.so"
STAMP = FOLDER / "VERSION"


def download(machine, folder):
    """The wheel for this machine, through pip and whatever index it is configured for."""
    pip = [sys.executable, "-m", "pip"]
    if subprocess.run([*pip, "--version"], capture_output=True).returncode != 0:
        raise SystemExit("pip is missing: run `apt-get install python3-pip` as root, then again")
    subprocess.run(
        [*pip, "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:",
         "--python-version", "3.11", "--implementation", "cp", "--abi", "cp311",
         "--platform", f"manylinux_2_28_{machine}", "--dest", folder, f"onnxruntime=={VERSION}"],
        check=True,
    )
    (wheel,) = Path(folder).glob("*.whl")
    return wheel


def main():
    if LIBRARY.is_file() and STAMP.is_file() and STAMP.read_text().strip() == VERSION:
        return
    machine = platform.machine()
    if platform.system() != "Linux" or machine not in WHEELS:
        raise SystemExit(
            f"no library is pinned for {platform.system()} on {machine}: install ONNX Runtime >= 1.23 and "
            "name it with ORT_DYLIB_PATH"
        )
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        wheel = download(machine, folder)
        checksum = hashlib.sha256(wheel.read_bytes()).hexdigest()
        if checksum != WHEELS[machine]:
            raise SystemExit(f"{wheel.name} has checksum {checksum}, expected {WHEELS[machine]}")
        with zipfile.ZipFile(wheel) as archive:
            content = archive.read(f"onnxruntime/capi/libonnxruntime.so.{VERSION}")
            (FOLDER / "LICENSE").write_bytes(archive.read("onnxruntime/LICENSE"))
    # Written whole or not at all: a process may have the old one open.
    partial = FOLDER / f"partial.{os.getpid()}"
    partial.write_bytes(content)
    partial.rename(LIBRARY)
    STAMP.write_text(VERSION + "\n")
    print(f"ONNX Runtime {VERSION} is in {LIBRARY}")


if __name__ == "__main__":
    main()
