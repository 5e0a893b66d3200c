"""Makes a Python environment with the pinned packages of a requirements file, unless it has them already.

    python3 tools/environment.py [.venv [tools/requirements.txt]]

The pip of the Python that runs this installs into the environment, which has none of its own: so Debian's python3-pip is
enough, and what Debian manages itself is left alone.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
# An environment made from source distributions could need compilers.
PIP = ["install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:"]


def pinned(requirements):
    """The lines of a requirements file, with those of the files that it names by `-r`."""
    lines = []
    for line in requirements.read_text().splitlines():
        other = line.removeprefix("-r ")
        lines += [line] if other == line else pinned(requirements.parent / other)
    return [line for line in lines if line and not line.startswith("#")]


def make(folder, requirements):
    """The environment's Python. An environment with other packages is replaced."""
    stamp, python = folder / "installed", folder / "bin" / "python"
    wanted = "\n".join([sys.version, *pinned(requirements)]) + "\n"
    if stamp.is_file() and stamp.read_text() == wanted:
        return python
    if folder.exists() and not (folder / "pyvenv.cfg").is_file():
        raise SystemExit(f"{folder} is there and no Python environment")
    shutil.rmtree(folder, ignore_errors=True)
    print(f"installing {requirements} into {folder}", flush=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    install = [sys.executable, "-m", "pip", "--python", python, *PIP, "--requirement", requirements]
    if subprocess.run(install, stdin=subprocess.DEVNULL).returncode != 0:
        raise SystemExit("pip failed; it must be there (apt-get install python3-pip) and be 22.3 or newer")
    stamp.write_text(wanted)
    return python


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=TOP / ".venv")
    parser.add_argument("requirements", type=Path, nargs="?", default=TOP / "tools" / "requirements.txt")
    arguments = parser.parse_args()
    make(arguments.folder, arguments.requirements)


if __name__ == "__main__":
    main()
