#!/usr/bin/env bash
# Checks fled on this machine's adapter: the kernels against their references, their cost, and a whole job.
#
#     gpu_check.sh [--quick] [--adapter NAME] [--folder DIR] [--out DIR] [-- ARGUMENTS OF `fled bench`]
#
# DIR is the output of tools/gpu_pack.py, by default the folder of this script. Only a Vulkan driver, bash and gzip are
# needed. Results go to OUT, by default ./gpu-check-results: tests.txt, blending.txt, bench.txt, bench.json, job.txt and
# the job's metrics.json. Every part runs even if others fail; the exit code is 0 if all succeed. The kernel tests take
# the best kind of adapter, ignoring NAME.
set -uo pipefail

folder=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
out=gpu-check-results
adapter=auto
quick=
bench=()
while (($#)); do
    case $1 in
    --quick) quick=1 ;;
    --adapter) adapter=${2:?--adapter wants a name} && shift ;;
    --folder) folder=$(cd "${2:?--folder wants a folder}" && pwd) && shift ;;
    --out) out=${2:?--out wants a folder} && shift ;;
    --) shift && bench=("$@") && break ;;
    *) echo "unknown argument: $1" >&2 && exit 2 ;;
    esac
    shift
done

mkdir -p "$out" || exit 1
out=$(cd "$out" && pwd)
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
for packed in "$folder"/*.gz; do
    name=$(basename "$packed" .gz)
    gzip -dc "$packed" >"$work/$name" && chmod +x "$work/$name" || exit 1
done
export ORT_DYLIB_PATH=$work/libonnxruntime.so

failed=()
# part NAME FILE COMMAND...: the command's output goes to the file.
part() {
    local name=$1 file=$2 begun=$SECONDS
    shift 2
    echo "== $name"
    if "$@" >"$out/$file" 2>&1; then
        echo "   well, $((SECONDS - begun)) s"
    else
        echo "   FAILED after $((SECONDS - begun)) s; the last of $out/$file:"
        tail -n 15 "$out/$file" | sed 's/^/   | /'
        failed+=("$name")
    fi
}

# The modules whose tests run kernels. Other tests need files of the repository. A quick check leaves out whole
# trainings.
kernels() {
    local modules=(splat:: noise:: shake:: render:: reconstruct::loss reconstruct::optimizer)
    [[ $quick ]] || modules+=(reconstruct:: agreement::)
    "$work/fled-gpu-tests" && "$work/fled-core-tests" "${modules[@]}" &&
        "$work/fled-lab-tests" "bench::${quick:+roofline}"
}

# Compares the speed of the blending kernels; `Specialisation::for_adapter` has the choice.
blending() {
    "$work/fled-core-tests" --ignored --nocapture blending_times
}

measure() {
    "$work/fled" bench ${quick:+--quick} --adapter "$adapter" --json "$out/bench.json" ${bench[@]+"${bench[@]}"}
}

# The capture includes its poses, so COLMAP only adds points, and its absence costs only those.
job() {
    local short=()
    [[ $quick ]] && short=(--set steps=200 --set cap=2000 --set rounds=1)
    "$work/fled" run "$folder/capture" --out "$work/job" --preset preview --cache none --set pose_source=given \
        --set adapter="$adapter" ${short[@]+"${short[@]}"} && cp "$work/job/metrics.json" "$out/metrics.json"
}

part "kernels against their references" tests.txt kernels
part "every way of blending" blending.txt blending
part "what they cost" bench.txt measure
part "a whole job" job.txt job

grep -h '^test result' "$out/tests.txt"
grep -A2 '^fled [0-9]' "$out/bench.txt"
if ((${#failed[@]})); then
    printf 'FAILED: %s\n' "${failed[@]}"
    exit 1
fi
echo "all well; results in $out"
