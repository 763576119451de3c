#!/usr/bin/env python3
"""Moving parts: joints against the truth, parts missed and invented, splats of parts.

    bench_parts.py SAT_RECON SHARED [NAME ...] --out FOLDER [--splat] [--video FILE ...] [--table]

NAME is a part of the names of the suite's videos that are made (default: all). Rigid videos may
have no part. `--video` adds videos of rigid objects without truth; `--splat` trains the rigid splat
and that of the parts of captures that have joints. One JSON file a capture in FOLDER/rows, the table in FOLDER/results: it is
not run again with the same program. `--table` runs nothing.
"""
import argparse
import glob
import json
import os
import shutil
import sys

import numpy as np

import bench_suite
import captures
import film
import judge
import part_shapes
import suite

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
import bench  # noqa: E402
import bench_results  # noqa: E402
import turntable  # noqa: E402

NEAR_DEG, NEAR_PCT = 10, 10  # a part is that of a joint whose axis is this near
SIZE_M = 2 * captures.RADIUS_M


def found_videos(cache):
    """{name: (folder, joints of the truth)} of the suite's videos that are made."""
    found = {}
    for folder in sorted(glob.glob(os.path.join(cache, "captures", "*"))):
        if os.path.isfile(os.path.join(folder, "video.mp4")) and os.path.isfile(os.path.join(folder, "motion.json")):
            name = os.path.basename(folder).rsplit("-", 1)[0]
            found[name] = folder, judge.read_json(os.path.join(folder, "motion.json")).get("joints", {})
    return found


def centres(folder):
    """{frame: centre} of a model."""
    poses = turntable.read_poses(turntable.model_folder(folder))
    return {os.path.splitext(n)[0]: np.array(turntable.centre(q, t)) for n, (q, t) in poses.items()}


def alignment(found, true):
    """Rotation, scale and translation that take the model found to the true one (Umeyama 1991)."""
    names = sorted(set(found) & set(true))
    a, b = (np.array([m[n] for n in names]) for m in (found, true))
    U, S, Vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    D = np.diag([1, 1, np.linalg.det(U @ Vt)])
    R = U @ D @ Vt
    scale = (S * np.diag(D)).sum() / ((a - a.mean(0)) ** 2).sum()
    return R, scale, b.mean(0) - scale * R @ a.mean(0)


def joint_errors(part, joint, frames, frame):
    """Errors of a part against a joint: axis (degrees), place (% of the size), angles about their
    mean (degrees, root mean square), and the share of angles within two stated deviations."""
    R, scale, shift = frame
    axis, place = R @ np.array(part["axis"]), scale * R @ np.array(part["place"]) + shift
    true_axis, true_place = np.array(joint["axis"]), np.array(joint["place"])
    true = np.array(joint["angles_deg"])[frames]
    errors = np.sign(axis @ true_axis) * np.array(part["angles_deg"]) - true
    off = errors - errors.mean()
    return {"axis_deg": float(np.degrees(np.arcsin(min(1, np.linalg.norm(np.cross(axis, true_axis)))))),
            "place_pct": float(100 * np.linalg.norm(np.cross(place - true_place, true_axis)) / SIZE_M),
            "angles_deg": float(np.sqrt((off ** 2).mean())),
            "within_2_sigma": float((np.abs(off) < 2 * np.array(part["angle_sigmas_deg"])).mean())}


def matched(parts, truth_folder, joints, model_folder):
    """{joint: errors} of the joints that were found, and how many parts are none."""
    found, invented = {}, 0
    if not parts["parts"]:
        return found, invented
    frame = alignment(centres(model_folder), centres(truth_folder))
    frames = [int("".join(c for c in os.path.splitext(f)[0] if c.isdigit())) for f in parts["frames"]]
    for part in parts["parts"]:
        all_errors = {n: joint_errors(part, j, frames, frame) for n, j in joints.items() if n not in found}
        near = {n: e for n, e in all_errors.items() if e["axis_deg"] < NEAR_DEG and e["place_pct"] < NEAR_PCT}
        best = min(near, key=lambda n: near[n]["angles_deg"], default=None)
        if best is None:
            invented += 1
        else:
            found[best] = near[best]
    return found, invented


def poses_row(folder, truth_folder):
    """Errors of the body's rotations of a model, degrees."""
    model, truth = judge.read_model(folder), judge.read_model(truth_folder)
    names = sorted(set(model) & set(truth))
    errors = judge.aligned_errors(*(np.array([m[n][0] for n in names]) for m in (model, truth)))
    return float(np.sqrt((errors ** 2).mean()))


def run(args, name, video, truth_folder, joints):
    """A row: what `sat-recon` and `sat-recon parts` make of a video."""
    folder = os.path.join(args.out, "runs", name)
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(os.path.dirname(folder), exist_ok=True)
    splat = args.splat and bool(joints)
    commands = [[args.sat_recon, *([] if splat else ["sfm"]), video, "-o", folder],
                [args.sat_recon, "parts", folder, *([] if splat else ["--no-splat"])]]
    row = {"capture": name, "half": captures.parse(name).half if truth_folder else "-", "joints": len(joints), "cpu_s": 0, "wall_s": 0, "peak_mib": 0}
    with open(folder + ".log", "w") as log:
        for command in commands:
            code, wall, cpu, peak = bench.measured(command, stdout=log, stderr=log)
            row |= {"cpu_s": row["cpu_s"] + cpu, "wall_s": row["wall_s"] + wall, "peak_mib": max(row["peak_mib"], peak), "exit": code}
    parts = judge.read_json(os.path.join(folder, "parts/parts.json"))
    if "parts" not in parts:
        return row | {"found": None}
    row |= {"found": len(parts["parts"]), "invented": len(parts["parts"])}
    if truth_folder:
        model = os.path.join(folder, "parts/sparse/0")
        by_joint, row["invented"] = matched(parts, truth_folder, joints, model)
        row |= {"by_joint": by_joint, "missed": len(joints) - len(by_joint),
                "rotation_deg": poses_row(model, truth_folder), "rotation_before_deg": poses_row(os.path.join(folder, "sparse/0"), truth_folder)}
        mesh = os.path.join(folder, "parts/parts.glb")
        if os.path.isfile(mesh):
            frame = alignment(centres(model), centres(truth_folder))
            row |= part_shapes.scores(mesh, film.mesh(captures.parse(name), suite.cache_folder(), args.shared), frame)
    for key, at in (("rigid", folder), ("of_parts", os.path.join(folder, "parts"))):
        mean = judge.read_json(os.path.join(at, "eval/metrics.json")).get("mean", {})
        row |= {f"psnr_{key}": mean.get("psnr"), f"psnr_mask_{key}": mean.get("psnr_mask")}
    return row


def told(row):
    """The row as the table has it: numbers of several joints side by side."""
    def several(key, digits):
        return ", ".join(f"{e[key]:.{digits}f}" for e in row.get("by_joint", {}).values()) or "–"

    wide = {k: several(k, d) for k, d in (("axis_deg", 2), ("place_pct", 2), ("angles_deg", 2), ("within_2_sigma", 2))}
    return {k: v for k, v in row.items() if v is not None} | wide | {"missed": row.get("missed", 0 if row["found"] is not None else "failed")}


def sums(rows):
    rigid, moving = [r for r in rows if not r["joints"]], [r for r in rows if r["joints"]]
    missed = sum(r.get("missed", r["joints"]) for r in moving)
    failed = sum(r["found"] is None for r in rows)
    return (f"{sum(r.get('invented') or 0 for r in rigid)} parts invented on {len(rigid)} rigid captures; "
            f"{missed} of {sum(r['joints'] for r in moving)} missed on {len(moving)} with joints"
            + (f"; {failed} runs failed and say nothing." if failed else "."))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sat_recon")
    parser.add_argument("shared")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--out", required=True)
    parser.add_argument("--splat", action="store_true")
    parser.add_argument("--video", nargs="*", default=[])
    parser.add_argument("--table", action="store_true")
    args = parser.parse_args()
    program, rows = bench_suite.digest(args.sat_recon), []
    os.makedirs(os.path.join(args.out, "rows"), exist_ok=True)
    table = bench_results.Results(os.path.join(args.out, "results")).table("parts")
    videos = {n: (os.path.join(f, "video.mp4"), os.path.join(f, "sparse"), j) for n, (f, j) in found_videos(suite.cache_folder()).items()}
    videos |= {os.path.splitext(os.path.basename(v))[0]: (v, None, {}) for v in args.video}
    for name, (video, truth, joints) in videos.items():
        if args.names and not any(n in name for n in args.names):
            continue
        path = os.path.join(args.out, "rows", f"{name}.json")
        row = judge.read_json(path)
        fresh = row.get("program") == program and (not args.splat or not joints or "psnr_of_parts" in row)
        if not fresh and not args.table:
            row = run(args, name, video, truth, joints) | {"program": program}
            with open(path, "w") as file:
                json.dump(row, file, indent=1)
        if row:
            rows.append(row)
            table.row(told(row))
    table.note(sums(rows))
    return 0 if rows else 1


if __name__ == "__main__":
    sys.exit(main())
