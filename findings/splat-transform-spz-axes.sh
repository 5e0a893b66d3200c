#!/usr/bin/env bash
# splat-transform 2.7.1 and 3.7.0 turn the same SPZ file into PLY files that are upside down to each other.
#
# SPZ's README says that y points up and z backwards (RUB), PLY files of 3D Gaussian splatting have y down and z forward
# (RDF). splat-transform 2.7.1 turns the axes when it reads SPZ; 3.7.0 copies the numbers. So a
# file that follows the README comes out of 3.7.0 upside down, and one that 3.7.0 writes from a PLY is upside down in
# programs that follow the README.
#
# Output seen with Node 20.20.2:
#   splat-transform 2.7.1: SPZ's (1, 2, 3) is (1, -2, -3) in the PLY
#   splat-transform 3.7.0: SPZ's (1, 2, 3) is (1, 2, 3) in the PLY
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat >make.py <<'PYTHON'
import gzip
import struct

# One opaque grey Gaussian: version 3, no higher harmonics, 12 bits after the point.
header = struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 0, 12, 0, 0)
position = b"".join((value << 12).to_bytes(3, "little") for value in (1, 2, 3))
opacity, colour, scales, rotation = bytes([250]), bytes([128] * 3), bytes([112] * 3), struct.pack("<I", 3 << 30)
open("one.spz", "wb").write(gzip.compress(header + position + opacity + colour + scales + rotation))
PYTHON
cat >read.py <<'PYTHON'
import struct
import sys

head, body = open(sys.argv[1], "rb").read().split(b"end_header\n", 1)
names = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property float ")]
row = dict(zip(names, struct.unpack_from(f"<{len(names)}f", body)))
print("(" + ", ".join(f"{row[axis]:g}" for axis in "xyz") + ")")
PYTHON
python3 make.py
for version in 2.7.1 3.7.0; do
  npm install --silent --prefix "$version" --ignore-scripts --no-audit --no-fund "@playcanvas/splat-transform@$version"
  "$version/node_modules/.bin/splat-transform" one.spz "$version.ply" >log 2>&1 || { cat log; exit 1; }
  read_as=$(python3 read.py "$version.ply")
  echo "splat-transform $version: SPZ's (1, 2, 3) is $read_as in the PLY"
  echo "$read_as" >>places
done
[ "$(cat places)" = $'(1, -2, -3)\n(1, 2, 3)' ]
