#!/usr/bin/env python3
"""What each step of the reconstruction is worth: every capture with each step left out.

    bench_skips.py SAT_RECON SHARED --out FOLDER [--only INPUT ...] [--steps STEP ...] [--seeds N]

The captures are the shared ones, the test bed's where they are rendered, and the photos and yaws of
the suite that `make suite` has filmed. Each runs with all steps and N seeds, whose range is the scatter, then once
for each value of `--skip`, but for steps that did nothing. A run that is in FOLDER already is not
repeated. The table names the captures whose AUC@1 leaves the scatter, with the change, and leaves
its rows in FOLDER/results as JSON; `skips` holds all runs, `worth` a row a step.
"""
import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys

import bench
import turntable
from bench_results import Results

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "suite"))
import captures as suite_captures  # noqa: E402
import suite  # noqa: E402

DATA = "data"
TEMPLE = ("data/temple_ring/images", "data/temple_ring/cameras_par.txt")
# Name, images and truth below SHARED (or absolute), options of degrade.py or None.
CAPTURES = [
    ("temple_ring", *TEMPLE, None),
    *((f"temple_ring, {name}", *TEMPLE, options) for name, options in bench.VARIANTS if "x 0.25" not in name and "x 2" not in name),
    ("fountain_p11", "data/fountain_p11/images", "data/fountain_p11/gt_dense_cameras", None),
    ("fox, every 2nd image", "data/fox/images", "data/fox/transforms.json", "--every 2"),
    ("lego400, every 3rd image", "data/lego400/images", "data/lego400/transforms.json", "--every 3"),
    ("oxford_dino", "data/oxford_dino/images", None, None),
    ("can_orbit", "data/phone_video/can_orbit.mp4", "data/phone_video/can_orbit_colmap", None),
    *((name, os.path.join(case, "images"), os.path.join(case, "sparse"), None) for name, case in bench.ORBITS),
    *((name, os.path.join(case, "video.mp4"), os.path.join(case, "sparse"), None) for name, case in bench.TURNS),
]
# What may be left out of photos, and of a video that is solved as a turn.
OF_PHOTOS = ["blurred-features", "constant-step", "guided-matching", "structureless-resection", "aliasing", "second-attempt",
             "circle-completion", "shared-cameras", "rotated-images", "densify", "subpixel", "plane-tracks", "isolated-points",
             "vertical-lines"]
OF_TURNS = ["photometric-closure", "vertical-lines"]
# Changes of AUC@1 (percent) that are as good as none, beside the scatter of the seeds.
LEAST_CHANGE = 0.3
# A step that took less looked whether it is needed and was not, CPU seconds.
IDLE_S = 0.02


def of_suite():
    """Rows as in CAPTURES of the photos and yaws of the suite that are filmed."""
    rows = []
    for capture in suite_captures.all_captures():
        folder = capture.folder(suite.cache_folder())
        named = capture.name.split("-")
        source = os.path.join(folder, "video.mp4" if capture.fps else "images")
        if os.path.exists(source) and (not capture.fps or "yaw" in named):
            rows.append(("suite, " + capture.name, source, os.path.join(folder, "sparse"), None))
    return rows


def of_dino(folder):
    """Rotations of a turntable of 10° steps: (AUC-like share of steps within 0.1°, deviation)."""
    steps = turntable.steps(turntable.read_poses(turntable.model_folder(folder)), False)
    return dict(step_sd_deg=steps["step_sd_deg"], step_mean_deg=steps["step_mean_deg"])


def solve(binary, source, truth, folder, flags):
    """A row as bench.solve gives it, kept beside the model; with the hash of the model's bytes."""
    kept = folder + ".json"
    if os.path.isfile(kept):
        with open(kept) as file:
            return json.load(file)
    row = bench.solve(binary, source, folder, ["--ignore-poses", *flags], truth)
    digest = hashlib.sha256()
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        path = os.path.join(folder, "sparse/0", name)
        if os.path.isfile(path):
            with open(path, "rb") as file:
                digest.update(file.read())
    row["bytes"] = digest.hexdigest()[:16]
    with open(os.path.join(folder, "run.json")) as file:
        row["steps"] = {name.removesuffix(", CPU s"): value for name, value in json.load(file)["poses"]["figures"]}
    if truth is None:
        row |= of_dino(folder)
    with open(kept, "w") as file:
        json.dump(row, file)
    shutil.rmtree(folder, ignore_errors=True)
    return row


def prepared(shared, out, name, source, options):
    """The capture's images, made harder where options say so."""
    source = os.path.join(shared, source)
    if options is None:
        return source
    images = os.path.join(out, "inputs", name)
    if not os.path.isdir(images):
        subprocess.run([sys.executable, os.path.join(shared, "tools/degrade.py"), source, images, *options.split()],
                       check=True, stdout=subprocess.DEVNULL)
    return images


def figure(row):
    """What a row is judged by: AUC@1, or without a truth the deviation of the steps, degrees."""
    return row.get("auc_1") or 0.0 if "step_sd_deg" not in row else -100 * row["step_sd_deg"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*", help="names of inputs")
    parser.add_argument("--steps", nargs="*", help="steps to leave out (default: all that can be)")
    parser.add_argument("--seeds", type=int, default=5)
    args = parser.parse_args()
    table = Results(os.path.join(args.out, "results")).table("skips")
    for name, source, truth, options in CAPTURES + of_suite():
        if (args.only and name not in args.only) or not os.path.exists(os.path.join(args.shared, source)):
            continue
        images = prepared(args.shared, args.out, name, source, options)
        truth = truth and os.path.join(args.shared, truth)
        folder = os.path.join(args.out, "runs", name)
        os.makedirs(folder, exist_ok=True)
        rows = [solve(args.binary, images, truth, os.path.join(folder, f"seed {seed}"), ["--seed", str(seed)])
                for seed in range(args.seeds)]
        figures = sorted(map(figure, rows))
        whole = rows[0] | dict(input=name, skipped="nothing", low=figures[0], high=figures[-1], change=0.0)
        table.row(whole)
        turn = source.endswith("case3/video.mp4") or source.endswith("case4/video.mp4") or "-yaw-" in source
        for step in args.steps or (OF_TURNS if turn else OF_PHOTOS):
            if whole["steps"].get(step, IDLE_S) < IDLE_S:
                continue
            row = solve(args.binary, images, truth, os.path.join(folder, step), ["--skip", step])
            same = row["bytes"] == whole["bytes"]
            table.row(row | dict(input=name, skipped=step, low=figures[0], high=figures[-1],
                                 change=None if same else figure(row) - figure(whole)))
    summarise(table.record["rows"], args.out)


def summarise(rows, out):
    """A row a step: how many captures it did something on, and those that leave the scatter without it."""
    table = Results(os.path.join(out, "results")).table("worth")
    for step in dict.fromkeys(row["skipped"] for row in rows if row["skipped"] != "nothing"):
        tried = [row for row in rows if row["skipped"] == step and row["total"]]
        moved = [row for row in tried if row["change"] is not None]
        outside = [row for row in moved if not row["low"] - LEAST_CHANGE <= figure(row) <= row["high"] + LEAST_CHANGE]
        said = lambda sign: "; ".join(f"{r['input']} {r['change']:+.1f}" for r in outside if r["change"] * sign > 0)  # noqa: E731
        table.row(dict(step=step, tried=len(tried), moved=len(moved), worse=said(-1) or "none", better=said(1) or "none"))


if __name__ == "__main__":
    main()
