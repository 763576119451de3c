#!/usr/bin/env bash
# Renders the simulated captures and their truth.
#   bash data/testbed/make.sh FOLDER [CASE...]       cases: demo case1 case2 case3 case4
#   calibration_stills calibration_video (all)
#   OBJECT=model.glb ... films a glTF model in the mock-up's place (into another FOLDER);
#   OBJECT=variant:SEED another satellite, drawn at random
#   ROOM=SEED ... has other things beside the green screen of cases 3 and 4 (into another FOLDER)
#   EVERY=K ... renders and films only every K-th frame of the shot, at a K-th of the rate
#   BLUE=1 ... exchanges green and blue in the light that reaches the sensor: a blue screen, another
#   mock-up
# Frames that exist are kept: stop it and start it again at will. Needs blender, python3-numpy
# (Debian's, which is also what Debian's Blender uses) and ffmpeg. Uses one thread.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
out=${1:?usage: make.sh FOLDER [CASE...]}
shift
[ $# -gt 0 ] || set -- demo case1 case2 case3 case4 calibration_stills calibration_video
python=/usr/bin/python3
every=${EVERY:-1}

for tool in blender ffmpeg "$python"; do
    command -v "$tool" >/dev/null || { echo "$tool is missing: apt-get install blender ffmpeg python3" >&2; exit 1; }
done
"$python" -c 'import numpy' 2>/dev/null || { echo "numpy is missing: apt-get install python3-numpy" >&2; exit 1; }

# Debian's Blender has no decoder for Draco.
if [ -n "${OBJECT:-}" ] && grep -aqs KHR_draco_mesh_compression "$OBJECT"; then
    mkdir -p "$out"
    "$python" "$here/undraco.py" "$OBJECT" "$out/object.glb"
    OBJECT=$out/object.glb
fi

for name in "$@"; do
    shot=$("$python" -c "import sys; sys.path.insert(0, '$here'); import cases; print(cases.CASES['$name'].shot)")
    mkdir -p "$out/renders/$shot" "$out/$name"
    echo "$name: rendering the shot '$shot'"
    nice -n 19 blender -b -t 1 --python-exit-code 1 --python "$here/render.py" -- \
        "$shot" "$out/renders/$shot" --frames "::$every" ${OBJECT:+--object "$OBJECT"} ${ROOM:+--room "$ROOM"} >"$out/renders/$shot/blender.log" 2>&1 ||
        { tail -20 "$out/renders/$shot/blender.log" >&2; exit 1; }
    "$python" "$here/develop.py" "$name" "$out/renders/$shot" "$out/$name" --every "$every" ${BLUE:+--blue}
    "$python" "$here/check.py" "$name" "$out/$name" --every "$every"
done
echo "processor seconds spent on rendering, all runs:"
awk '{ s[FILENAME] += $3; n[FILENAME]++ } END { for (f in s) printf "  %s: %.0f s, %d renders\n", f, s[f], n[f] }' "$out"/renders/*/cpu_s.txt
