#!/usr/bin/env bash
# Films what the key's outline is learnt from and trains it (docs/decisions/04).
#   bash tools/train_outline.sh FOLDER ["SEED..." [SCENES [EPOCHS]]]  (130 satellites, 140 scenes, 22)
# Writes FOLDER/outline.f32; copy it to preprocess/src/matting/refine_network.f32 to use it. What is
# filmed already is kept: stop it and start it again at will. Some two and a half hours of two
# cores, 25 GB of disk and 18 of memory. Needs blender, ffmpeg, and python3 with numpy, scipy and
# pillow (PYTHON=...).
set -euo pipefail
out=$(realpath -m "${1:?usage: train_outline.sh FOLDER [SEEDS [SCENES [EPOCHS]]]}")
cd "$(dirname "$0")/.."
seeds=${2:-$(echo {1..58} {71..94} {101..148})} scenes=${3:-140} epochs=${4:-22} python=${PYTHON:-python3} every=18

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

# Frames a twelfth of a turn apart are coded one by one, and well. In a video most are made from
# their neighbours, and what is coded of them is less: each film once more, coded by 3, 5 or 7 steps
# of x264's quality worse.
code_coarsely() {
    local film=$1 crf=$2 folder
    folder=$out/coarse/$(basename "$(dirname "$film")")_$(basename "$film")
    [ -e "$folder/coded" ] && return
    mkdir -p "$folder"
    ln -sfn "$film/mattes" "$folder/mattes"
    ffmpeg -nostdin -y -v error -i "$film/video.mp4" -c:v libx264 -preset slow -crf "$crf" -pix_fmt yuv420p -colorspace bt709 -color_primaries bt709 \
        -color_trc iec61966-2-1 -color_range tv -bf 2 -g 48 -threads 1 "$folder/video.mp4"
    touch "$folder/coded"
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
k=0
for film in "$out"/satellite_*/case[34]*; do
    case $film in *case3*) crf=23 ;; *) crf=20 ;; esac
    k=$((k + 1))
    code_coarsely "$film" $((crf + 3 + 2 * (k % 3)))
done
[ -e "$out/shapes/$(printf %03d $((scenes - 1)))/video.mp4" ] || "$python" tools/outline_shapes.py "$out/shapes" 0 "$scenes"
cargo build --release --locked --workspace --example outline_samples
samples=${CARGO_TARGET_DIR:-target}/release/examples/outline_samples
"$samples" "$out/satellites.bin" --every 6 "$out"/satellite_*/case[34]*
"$samples" "$out/coarse.bin" --every 4 "$out"/coarse/*
"$samples" "$out/shapes.bin" --every 5 "$out"/shapes/*
"$python" tools/train_outline.py "$out/outline.f32" "$out/satellites.bin" "$out/coarse.bin" "$out/shapes.bin" --epochs "$epochs"
