"""Puts the ONNX Runtime library into .onnxruntime/ at the top of the repository.

    python3 tools/fetch_onnxruntime.py

The library comes out of the PyPI wheel, whose checksum is pinned here. Every wheel of a version carries the same
library whatever Python it is for, so one tag is enough. Does nothing when the library is already there.
"""

import platform
import tempfile
import zipfile
from pathlib import Path

import pypi

VERSION = "1.31.1"
WHEELS = {
    "x86_64": "5752bd508126ae7c49894d3b9d2e83f0c3d487319246d04c444b393308d7ad7f",
    "aarch64": "da05378364c44d4407e463982d2bf8d5e4cfea873283757e48beeb41df97b7f3",
}
FOLDER = Path(__file__).resolve().parent.parent / ".onnxruntime"
LIBRARY = FOLDER / "libonnxruntime.so"
STAMP = FOLDER / "VERSION"


def download(machine, folder):
    """The wheel for this machine."""
    tags = ["--implementation", "cp", "--abi", "cp311", "--platform", f"manylinux_2_28_{machine}"]
    return pypi.download(f"onnxruntime=={VERSION}", folder, *tags)


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
        pypi.check(wheel.name, wheel.read_bytes(), WHEELS[machine])
        with zipfile.ZipFile(wheel) as archive:
            content = archive.read(f"onnxruntime/capi/libonnxruntime.so.{VERSION}")
            (FOLDER / "LICENSE").write_bytes(archive.read("onnxruntime/LICENSE"))
    pypi.write(LIBRARY, content)
    STAMP.write_text(VERSION + "\n")
    print(f"ONNX Runtime {VERSION} is in {LIBRARY}")


if __name__ == "__main__":
    main()
