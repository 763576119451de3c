#!/usr/bin/env bash
# Copies the part of a case that the repository ships: picture, poses, mesh, some mattes and depths.
#   bash data/testbed/ship.sh FOLDER/case3
set -euo pipefail

from=${1:?usage: ship.sh FOLDER/CASE}
to=$(cd "$(dirname "$0")" && pwd)/$(basename "$from")
mkdir -p "$to"/{sparse,mattes,pole,depth}
cp "$from"/sparse/*.txt "$to/sparse/"
cp "$from"/mesh.ply "$to/"
for name in video.mp4 angles_deg.txt images; do
    if [ -e "$from/$name" ]; then cp -r "$from/$name" "$to/"; fi
done
# Every 6th matte (10 degrees apart in a yaw); depth and pole of every 54th frame.
n=0
for matte in "$from"/mattes/*.png; do
    stem=$(basename "$matte")
    if [ $((n % 6)) -eq 0 ]; then cp "$matte" "$to/mattes/"; fi
    if [ $((n % 54)) -eq 0 ]; then cp "$from/pole/$stem" "$to/pole/"; cp "$from/depth/$stem" "$to/depth/"; fi
    n=$((n + 1))
done
du -sh "$to"
(cd "$to/.." && sha256sum "$(basename "$to")"/{video.mp4,mesh.ply,angles_deg.txt,sparse/*} 2>/dev/null || true)
