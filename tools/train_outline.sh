#!/usr/bin/env bash
# Films what the key's outline is learnt from and trains it (decision 0027).
#   bash tools/train_outline.sh FOLDER ["SEED..." [SCENES [EPOCHS]]]      (130 satellites, 140 scenes, 7)
# Writes FOLDER/outline.f32; copy it to preprocess/src/chroma/ to use it. What is filmed already is kept: stop it and start it again at will. Some two
# hours of two cores, 15 GB of disk and 10 of memory. Needs blender, ffmpeg, and python3 with numpy, scipy and pillow (PYTHON=...).
set -euo pipefail
out=$(realpath -m "${1:?usage: train_outline.sh FOLDER [SEEDS [SCENES [EPOCHS]]]}")
cd "$(dirname "$0")/.."
seeds=${2:-$(echo {1..58} {71..94} {101..148})} scenes=${3:-140} epochs=${4:-7} python=${PYTHON:-python3} every=18

film() {
    local k=$1 folder=$out/satellite_$1
    [ -e "$folder/filmed" ] && return
    if [ -d "$out/empty" ]; then # Pole and room without a satellite are the same for all.
        mkdir -p "$folder/renders/yaw"
        cp -r "$out/empty/." "$folder/renders/yaw/"
    fi
    EVERY=$every OBJECT=variant:$k bash data/testbed/make.sh "$folder" case4
    "$python" data/testbed/develop.py case4 "$folder/renders/yaw" "$folder/case4_blue" --every $every --blue
    "$python" data/testbed/develop.py case3 "$folder/renders/yaw" "$folder/case3" --every $every
    "$python" data/testbed/develop.py case3 "$folder/renders/yaw" "$folder/case3_blue" --every $every --blue
    touch "$folder/filmed"
}

mkdir -p "$out"
read -ra seeds <<<"$seeds"
film "${seeds[0]}"
mkdir -p "$out/empty"
cp -r "$out/satellite_${seeds[0]}"/renders/yaw/{base,clean} "$out/empty/"
for half in 0 1; do
    (for ((k = half; k < ${#seeds[@]}; k += 2)); do film "${seeds[k]}"; done) &
done
wait -n
wait -n
for k in "${seeds[@]}"; do [ -e "$out/satellite_$k/filmed" ] || { echo "satellite $k was not filmed" >&2; exit 1; }; done
[ -e "$out/shapes/$(printf %03d $((scenes - 1)))/video.mp4" ] || "$python" tools/outline_shapes.py "$out/shapes" 0 "$scenes"
cargo build --release --locked --workspace --example outline_samples
samples=${CARGO_TARGET_DIR:-target}/release/examples/outline_samples
"$samples" "$out/satellites.bin" --every 4 "$out"/satellite_*/case[34]*
"$samples" "$out/shapes.bin" --every 5 "$out"/shapes/*
"$python" tools/train_outline.py "$out/outline.f32" "$out/satellites.bin" "$out/shapes.bin" --epochs "$epochs"
