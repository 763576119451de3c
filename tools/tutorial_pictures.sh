#!/usr/bin/env bash
# Makes the pictures of docs/tutorial.md from a run of the demo.
#
#   tools/tutorial_pictures.sh SAT_RECON RUN
#
# RUN is the output folder of `make demo`. Needs ffmpeg, Chromium and the viewer's Node.js packages
# (`make viewer`).
# Writes docs/pictures/*.jpg, each at most 100 kB.
set -euo pipefail
program=$(realpath "$1")
run=$(realpath "$2")
here=$(dirname "$(realpath "$0")")
out=$here/../docs/pictures
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir -p "$out"
ff() { ffmpeg -v error -y "$@"; }

# Four frames of the video, as they were filmed.
ff -i "$here/../data/testbed/case3/video.mp4" -frames:v 1 -q:v 4 \
  -vf "select='eq(n,0)+eq(n,30)+eq(n,80)+eq(n,130)',scale=320:-1,tile=4x1" "$out/frames.jpg"

# The first rows of the mattes.
ff -i "$run/mattes.png" -vf "crop=iw:ih/2:0:0,scale=1100:-1" -q:v 5 "$out/mattes.jpg"

# Photo above render, of four held-out views.
i=0
inputs=()
for view in $(ls "$run/eval/photos" | awk 'NR % 3 == 2' | head -n 4); do
  ff -i "$run/eval/photos/$view" -i "$run/eval/renders/$view" -filter_complex \
    "[0]crop=iw*0.7:ih*0.7[a];[1]crop=iw*0.7:ih*0.7[b];[a][b]vstack,scale=300:-1" "$work/pair$i.png"
  inputs+=(-i "$work/pair$i.png")
  i=$((i + 1))
done
ff "${inputs[@]}" -filter_complex "hstack=inputs=$i" -q:v 4 "$out/held_out.jpg"

# New views along an orbit: colour above depth.
for channel in color depth; do
  "$program" render "$run" -o "$work/$channel" --count 8 --channel "$channel" --quiet
  ff -framerate 1 -start_number 0 -i "$work/$channel/%05d.png" -frames:v 1 \
    -vf "select='not(mod(n,2))',crop=iw*0.7:ih*0.7,scale=300:-1,tile=4x1" "$work/$channel.png"
done
ff -i "$work/color.png" -i "$work/depth.png" -filter_complex vstack -q:v 4 "$out/orbit.jpg"

# Report and viewer, as a browser shows them.
"$program" export "$run" --html -o "$work/view.html"
node "$here/tutorial_pages.mjs" "$(command -v chromium)" "$run/report.html" "$work/view.html" "$work"
for name in verdict decisions poses viewer; do
  ff -i "$work/$name.png" -vf "scale='min(840,iw)':-1" -q:v 6 "$out/$name.jpg"
done
du -b "$out"/*.jpg | awk '$1 > 100000 { print $2 " is larger than 100 kB"; bad = 1 } END { exit bad }'
