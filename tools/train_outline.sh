#!/usr/bin/env bash
# Films what the key's outline is learnt from and trains it (decision 0027).
#   bash tools/train_outline.sh FOLDER [SATELLITES [SCENES [EPOCHS]]]      (10, 70, 16)
# Writes FOLDER/outline.f32; copy it to preprocess/src/chroma/ to use it. What is filmed already is kept: stop it and start it again at will. Half an
# hour of two cores, 6 GB of disk and as much memory. Needs blender, ffmpeg, and python3 with numpy, scipy and pillow (PYTHON=...).
set -euo pipefail
out=$(realpath -m "${1:?usage: train_outline.sh FOLDER [SATELLITES [SCENES [EPOCHS]]]}")
cd "$(dirname "$0")/.."
satellites=${2:-10} scenes=${3:-70} epochs=${4:-16} python=${PYTHON:-python3} every=9

film() {
    local k=$1 folder=$out/satellite_$1
    [ -e "$folder/filmed" ] && return
    EVERY=$every OBJECT=variant:$k bash data/testbed/make.sh "$folder" case4
    "$python" data/testbed/develop.py case4 "$folder/renders/yaw" "$folder/case4_blue" --every $every --blue
    "$python" data/testbed/develop.py case3 "$folder/renders/yaw" "$folder/case3" --every $every
    "$python" data/testbed/develop.py case3 "$folder/renders/yaw" "$folder/case3_blue" --every $every --blue
    touch "$folder/filmed"
}

mkdir -p "$out"
for half in 0 1; do
    (for k in $(seq $((1 + half)) 2 "$satellites"); do film "$k"; done) &
done
wait -n
wait -n
for k in $(seq 1 "$satellites"); do [ -e "$out/satellite_$k/filmed" ] || { echo "satellite $k was not filmed" >&2; exit 1; }; done
[ -e "$out/shapes/$(printf %03d $((scenes - 1)))/video.mp4" ] || "$python" tools/outline_shapes.py "$out/shapes" 0 "$scenes"
cargo build --release --locked --workspace --example outline_samples
samples=${CARGO_TARGET_DIR:-target}/release/examples/outline_samples
"$samples" "$out/satellites.bin" "$out"/satellite_*/case[34]*
"$samples" "$out/shapes.bin" --every 5 "$out"/shapes/*
"$python" tools/train_outline.py "$out/outline.f32" "$out/satellites.bin" "$out/shapes.bin" --epochs "$epochs" --most 4700000
