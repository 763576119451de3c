#!/usr/bin/env python3
"""Shapes of the suite's turns against the true meshes: clouds, splat and fused mesh; and the lamp.

    bench_shapes.py SAT_RECON SHARED --out FOLDER [NAME ...] [--quality PRESET]

NAME is a part of captures' names (default: yaw-low-4 and yaw-full-4 of what `make suite` has
filmed). One JSON file a capture in FOLDER/results; it is not run again with the same program.
Half A of the objects may be used to choose things, half B never.
"""
import argparse
import json
import math
import os
import re
import subprocess
import sys
import time

import bench_suite
import captures
import film
import suite

SURFACES = (("sparse cloud", "cloud"), ("splat", "surface"), ("dense cloud", "dense"), ("fused mesh", "fused"))


def run(args, capture, folder):
    """What `eval` says of a capture's geometry, and how long it took."""
    out = os.path.join(args.out, capture.name)
    mesh = film.mesh(capture, suite.cache_folder(), args.shared)
    command = [args.sat_recon, "eval", os.path.join(folder, "video.mp4"), "-o", out, "-q", "--quality", args.quality,
               "--mesh", mesh, "--mesh-truth", os.path.join(folder, "sparse")]
    begun = time.time()
    code = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
    evaluation = bench_suite.judge.read_json(os.path.join(out, "run.json")).get("evaluation", {})
    return {"name": capture.name, "half": capture.half, "exit_code": code, "wall_s": time.time() - begun,
            "geometry": evaluation.get("geometry", {}), "psnr": evaluation.get("psnr"), "lamp": lamp(args, capture, out)}


def lamp(args, capture, out):
    """Degrees to the right and above, and the deviation, of the lamp found; how far off it is."""
    said = subprocess.run([args.sat_recon, "render", out, "-o", os.path.join(out, "relit"), "--path", "test", "--light=0,0"],
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True).stdout
    match = re.search(r"a lamp (-?\d+)° to the camera's right and (-?\d+)° above it \(± (\d+)°\)", said)
    if not match:
        return None
    right, above, deviation = map(int, match.groups())
    a, b = (direction(*angles) for angles in ((right, above), captures.lamp_of(capture)))
    off = math.degrees(math.acos(min(1, sum(x * y for x, y in zip(a, b)))))
    return {"right": right, "above": above, "deviation": deviation, "off": off, "doubtful": "doubtful" in said}


def direction(right, above):
    a, e = math.radians(right), math.radians(above)
    return math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)


def thin(geometry):
    found = geometry.get("thin_recall_pct")
    return "–" if found is None else f"{found:.1f}"


def show(results):
    print("| capture | half | surface | F-score at 1 %, at 0.5 % | precision, recall at 1 % | rods and edges of sheets, % | accuracy, completeness, % | wall s |")
    print("|---|---|---|---|---|---|---|---|")
    for r in results:
        for name, key in SURFACES:
            g = r["geometry"].get(key)
            if g:
                print(f"| {r['name']} | {r['half']} | {name} | {g['f_score_pct']:.1f}, {g.get('f_score_half_pct', float('nan')):.1f} | "
                      f"{g['precision_pct']:.1f}, {g['recall_pct']:.1f} | {thin(g)} | {g['accuracy_mean_pct']:.3f}, "
                      f"{g['completeness_mean_pct']:.3f} | {r['wall_s']:.0f} |")
    print("\n| capture | half | lamp, right and above | found | off by | said |")
    print("|---|---|---|---|---|---|")
    for r in results:
        right, above = captures.lamp_of(captures.parse(r["name"]))
        row, found = f"| {r['name']} | {r['half']} | {right:.0f}°, {above:.0f}°", r.get("lamp")
        if found:
            print(f"{row} | {found['right']}°, {found['above']}° | {found['off']:.0f}° | ± {found['deviation']}°"
                  f"{', doubtful' if found['doubtful'] else ''} |")
        else:
            print(f"{row} | – | – | no lamp |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sat_recon")
    parser.add_argument("shared")
    parser.add_argument("names", nargs="*", default=["yaw-low-4", "yaw-full-4"])
    parser.add_argument("--out", required=True)
    parser.add_argument("--quality", default="draft")
    args = parser.parse_args()
    program, results = bench_suite.digest(args.sat_recon), []
    os.makedirs(os.path.join(args.out, "results"), exist_ok=True)
    for capture in captures.all_captures():
        folder = capture.folder(suite.cache_folder())
        if not os.path.isfile(os.path.join(folder, "video.mp4")) or not any(n in capture.name for n in args.names):
            continue
        path = os.path.join(args.out, "results", f"{capture.name}-{args.quality}.json")
        result = bench_suite.judge.read_json(path)
        if result.get("program") != program:
            result = run(args, capture, folder) | {"program": program}
            with open(path, "w") as file:
                json.dump(result, file, indent=1)
        results.append(result)
    show(results)
    return 0 if results else 1


if __name__ == "__main__":
    sys.exit(main())
