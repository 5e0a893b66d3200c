#!/bin/sh
# Draws the sample that the server ships, src/server/sample/, with FLED or the checkout's program:
# JPEG files of `fled synth`, because drawing them takes a minute on a busy machine. Run once, with
# the result committed.
set -eu
cd "$(dirname "$0")/.."
fled=${FLED:-${CARGO_TARGET_DIR:-target}/release/fled}
out=src/server/sample
drawn=$(mktemp -d)
trap 'rm -rf "$drawn"' EXIT
"$fled" synth "$drawn/capture" --views 20
rm -rf "$out"
mkdir -p "$out/images" "$out/HL"
cp "$drawn/capture/poses_bounds.npy" "$out/"
for file in "$drawn"/capture/images/*.png "$drawn"/capture/HL/*.png; do
    folder=$(basename "$(dirname "$file")")
    # The first frame, in full colour, without metadata: equal bytes each time.
    ffmpeg -loglevel error -i "$file" -frames:v 1 -q:v 2 -pix_fmt yuvj444p -bitexact \
        "$out/$folder/$(basename "$file" .png).jpg"
done
