#!/usr/bin/env bash
# Installs what fled needs from Debian: COLMAP, ffmpeg, LibRaw's programs, the Vulkan loader, and pip to fetch the ONNX
# Runtime library and the Python packages of the tools; and the arguments: `vulkan`, a software driver on which the
# tests check the kernels for GPUs, and programs whose package has their name, including `postgresql`, which Debian does
# not put on the path.
# Installs only what is missing; without root it prints the one line to run instead.
set -euo pipefail

# Ordinary users do not have /sbin in their path.
libraries=$(PATH=$PATH:/sbin:/usr/sbin ldconfig -p)

missing=()
command -v colmap >/dev/null || missing+=(colmap)
[[ $libraries == *libvulkan.so.1* ]] || missing+=(libvulkan1)
command -v ffmpeg >/dev/null || missing+=(ffmpeg)
command -v dcraw_emu >/dev/null || missing+=(libraw-bin)
python3 -m pip --version >/dev/null 2>&1 || missing+=(python3-pip)
for program; do
    if [[ $program == vulkan ]]; then
        compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null || compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null ||
            missing+=(mesa-vulkan-drivers)
        continue
    fi
    [[ $program == postgresql ]] && compgen -G '/usr/lib/postgresql/*/bin/initdb' >/dev/null && continue
    command -v "$program" >/dev/null || missing+=("$program")
done
((${#missing[@]})) || exit 0

install=(apt-get install -y --no-install-recommends "${missing[@]}")
if ((EUID != 0)); then
    echo "Missing: ${missing[*]}. Run this as root, then the same make command again:" >&2
    echo "  apt-get update && ${install[*]}" >&2
    exit 1
fi
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
"${install[@]}" -qq >/dev/null
