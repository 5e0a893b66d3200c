#!/bin/sh
# Makes the sample that the server ships, src/server/sample/, with FLED or the checkout's program:
# photographs of a made-up room at dusk, as JPEG files, and the finished result of a run of them. Run
# once, with the result committed. Pictures are compressed as far as 2 MB for all of it require.
set -eu
cd "$(dirname "$0")/.."
fled=${FLED:-${CARGO_TARGET_DIR:-target}/release/fled}
out=src/server/sample
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT

# FROM TO QUALITY SAMPLING: the first frame, without metadata.
jpeg() {
    mkdir -p "$(dirname "$2")"
    ffmpeg -nostdin -loglevel error -y -i "$1" -frames:v 1 -q:v "$3" -pix_fmt "$4" -bitexact "$2"
}

"$fled" synth "$made/drawn" --views 16 --room study
rm -rf "$out"
for file in "$made"/drawn/images/*.png; do
    jpeg "$file" "$out/capture/images/$(basename "$file" .png).jpg" 2 yuvj444p
done
for file in "$made"/drawn/HL/*.png; do
    jpeg "$file" "$out/capture/HL/$(basename "$file" .png).jpg" 3 yuvj420p
done
cp "$made/drawn/poses_bounds.npy" "$out/capture/"

"$fled" run "$out/capture" --out "$made/run" --cache "$made/cache" --json >"$made/events"
mkdir -p "$out/run" "$out/result"
"$fled" --version | gzip -9n >"$out/run/version.txt.gz"
# What a page shows of a job that has ended.
grep -Ev '"event":"(log|progress|stage_advanced|view_seen)"' "$made/events" |
    gzip -9n >"$out/run/events.jsonl.gz"
for name in cameras.json config.json log.txt metrics.json poses.json poses.svg; do
    gzip -9nc "$made/run/$name" >"$out/result/$name.gz"
done
"$fled" export "$made/run" scene.v3.spz --output "$out/result/scene.spz"
for round in "$made"/run/rounds/*; do
    to="$out/result/rounds/$(basename "$round")"
    for file in "$round"/*/*.jpg; do
        jpeg "$file" "$to/$(basename "$(dirname "$file")")/$(basename "$file")" 5 yuvj420p
    done
    gzip -9nc "$round/training.json" >"$to/training.json.gz"
    gzip -9nc "$round/cameras.json" >"$to/cameras.json.gz"
done
