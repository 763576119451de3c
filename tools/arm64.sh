#!/bin/bash
# The whole program for 64-bit ARM, cross-built here and run on an emulated processor:
#   arm64.sh OUT build|run|wheel|test...
# build: the release binary; run: the sample video, its poses against the truth; wheel: a Python wheel of
# the binary; test: unit tests of `sfm` and `scene` (hours). OUT/sysroot gets Debian's libraries for
# ARM, unpacked and not installed: the packages of this machine stay as they are.
set -euo pipefail
cd "$(dirname "$0")/.."
mkdir -p "$1"
out=$(realpath "$1")
shift
root=$out/sysroot
libraries=$root/usr/lib/aarch64-linux-gnu
target=aarch64-unknown-linux-gnu
products=${CARGO_TARGET_DIR:-target}
program=$products/$target/release/sat-recon

if [ ! -e "$root/.made" ]; then
  rm -rf "$root"
  mmdebstrap --quiet --variant=extract --arch=arm64 --include=libceres-dev,libsqlite3-dev,libstdc++-12-dev \
      bookworm "$root" http://deb.debian.org/debian
  # What update-alternatives would choose.
  for name in blas lapack; do ln -sf "atlas/lib$name.so.3" "$libraries/lib$name.so.3"; done
  # Absolute links lead out of the folder.
  for link in "$libraries"/*.so; do
    to=$(readlink "$link" || true)
    [ "${to#/}" = "$to" ] || ln -sf "$root$to" "$link"
  done
  rm -rf "$root/dev"
  touch "$root/.made"
fi
rustup target add "$target" 2>/dev/null
export PKG_CONFIG_ALLOW_CROSS=1 PKG_CONFIG_SYSROOT_DIR=$root
export PKG_CONFIG_LIBDIR=$libraries/pkgconfig:$root/usr/share/pkgconfig
export CC_aarch64_unknown_linux_gnu=aarch64-linux-gnu-gcc CXX_aarch64_unknown_linux_gnu=aarch64-linux-gnu-g++
export CFLAGS_aarch64_unknown_linux_gnu=--sysroot=$root CXXFLAGS_aarch64_unknown_linux_gnu=--sysroot=$root
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-g++
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUSTFLAGS="-C link-arg=--sysroot=$root"
# Programs that it starts, as ffmpeg, are this machine's own.
emulator="qemu-aarch64-static -L $root"
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER=$emulator

for part in "$@"; do
  case $part in
    build) cargo build --release --locked -j2 --target "$target" ;;
    # Solvers, bundle adjustment (Ceres), matching kernels, files: what differs between processors.
    test) cargo test --locked -j2 --target "$target" -p sfm -p scene --lib ;;
    run)
      rm -rf "$out/sample"
      status=0
      $emulator "$program" sfm data/sample/orbit.mp4 -o "$out/sample" --frames 24 --quality draft --quiet || status=$?
      # 3: a small sample may be doubtful; its poses are judged below.
      [ "$status" -eq 0 ] || [ "$status" -eq 3 ]
      $emulator "$program" compare "$out/sample" --truth data/sample/orbit_truth
      ;;
    wheel) tools/wheel.sh "$program" "$out/wheels" "$root" ;;
    *) echo "arm64.sh does not know $part" >&2; exit 1 ;;
  esac
done
