#!/usr/bin/env bash
# Checks that all but the service and its command line compiles for systems that no test runs on.
# `cargo check` links nothing, so it needs neither their libraries nor a compiler of C for them:
# build scripts get one that writes nothing.
set -euo pipefail
cd "$(dirname "$0")/.."

# A fixed path, because a changed one makes cargo run build scripts again.
stub=$(realpath -m "${CARGO_TARGET_DIR:-target}/check-systems/cc")
mkdir -p "$(dirname "$stub")"
cat >"$stub" <<'STUB'
#!/usr/bin/env bash
# A compiler and an archiver: makes the file that its arguments name as output, empty.
while (($#)); do
    case $1 in
    -o) : >"$2" && shift ;;
    -Fo* | /Fo*) : >"${1#?Fo}" ;;
    -out:* | /out:*) : >"${1#?out:}" ;;
    *.a) : >"$1" ;;
    esac
    shift
done
STUB
chmod +x "$stub"

targets=()
for target in aarch64-apple-darwin x86_64-pc-windows-msvc; do
    targets+=(--target "$target")
    key=${target//-/_}
    export "CC_$key=$stub" "CXX_$key=$stub" "AR_$key=$stub"
done
rustup target add aarch64-apple-darwin x86_64-pc-windows-msvc
exec "${CARGO:-cargo}" check --release --locked "${targets[@]}" -p fled-core -p fled-lab
