#!/usr/bin/env bash
# Checks kernels and a job on SwiftShader, a Vulkan driver with few more resources than WebGPU promises: what
# runs on it should run on the GPUs of phones and small boards. Debian's Chromium has it.
set -euo pipefail
cd "$(dirname "$0")/.."

driver=${SWIFTSHADER:-/usr/lib/chromium/vk_swiftshader_icd.json}
if [[ ! -f $driver ]]; then
    echo "SwiftShader is missing: set SWIFTSHADER to its vk_swiftshader_icd.json" >&2
    exit 1
fi
fled=$(realpath "${FLED:-${CARGO_TARGET_DIR:-target}/release/fled}")
export VK_DRIVER_FILES=$driver

"${CARGO:-cargo}" test --release --locked --quiet --workspace --lib -- splat:: shake:: reconstruct::{loss,optimizer}
"$fled" doctor --adapter swiftshader >/dev/null

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$fled" synth "$folder/room" --views 12 --size 96x64 --layout transforms
options=(adapter=swiftshader exposure=as_taken steps=20 size=96 cap=500 rounds=1 deblur=identity pose_source=given)
"$fled" run "$folder/room" --out "$folder/run" --cache none "${options[@]/#/--set=}"
grep -q '"adapter": "SwiftShader' "$folder/run/metrics.json"
