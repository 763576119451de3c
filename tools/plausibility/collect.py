#!/usr/bin/env python3
"""The table of captures that the probability of a right model is fitted to.

    collect.py SAT_RECON SHARED --out FOLDER [--only PART ...] [--table FILE]

Solves every capture of the suite that is made, the made-wrong set and real sets with truth (and
thinned and degraded copies of these), judges each model by its truth and writes one row a capture:
its half, whether the model is right, and the features that `run.json` holds. Half A is for fitting;
half B never is. A capture is not run again with the same program.
"""
import argparse
import csv
import glob
import json
import os
import shutil
import subprocess
import sys

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
TOOLS = os.path.join(HERE, "..")
sys.path[:0] = [TOOLS, os.path.join(TOOLS, "suite")]
import bench  # noqa: E402
import bench_suite  # noqa: E402
import captures  # noqa: E402
import judge  # noqa: E402
import suite  # noqa: E402

# Real sets: images, truth, half, and which harder copies are made.
REAL = {
    "temple_ring": ("temple_ring/images", "temple_ring/cameras_par.txt", "A"),
    "fountain_p11": ("fountain_p11/images", "fountain_p11/gt_dense_cameras", "B"),
    "fox": ("fox/images", "fox/transforms.json", "A"),
    "lego400": ("lego400/images", "lego400/transforms.json", "B"),
    "oxford_dino": ("oxford_dino/images", None, "B"),
}
DARK = ["--mask", "--gain", "0.1", "--noise", "3"]
COPIES = [
    ("temple_ring", "every2", ["--every", "2"]), ("temple_ring", "every3", ["--every", "3"]),
    ("temple_ring", "every4", ["--every", "4"]), ("temple_ring", "every5", ["--every", "5"]),
    ("temple_ring", "dark", DARK), ("temple_ring", "dark2", [*DARK, "--every", "2"]),
    ("fountain_p11", "every2", ["--every", "2"]), ("fountain_p11", "every3", ["--every", "3"]),
    ("temple_ring", "every6", ["--every", "6"]), ("temple_ring", "dark3", [*DARK, "--every", "3"]), ("temple_ring", "dark4", [*DARK, "--every", "4"]),
    ("fox", "every2", ["--every", "2"]), ("fox", "every3", ["--every", "3"]), ("fox", "every4", ["--every", "4"]), ("lego400", "every2", ["--every", "2"]),
    ("lego400", "every3", ["--every", "3"]), ("lego400", "every5", ["--every", "5"]), ("lego400", "every9", ["--every", "9"]),
    ("oxford_dino", "every2", ["--every", "2"]), ("oxford_dino", "every3", ["--every", "3"]),
    ("oxford_dino", "dark", ["--gain", "0.1", "--noise", "3"]),
]
# Captures that the program ships with, and coarser runs of them.
SHIPPED_FILES = {"sample": ("orbit.mp4", "orbit_truth"), "testbed/case3": ("video.mp4", "sparse")}
SHIPPED = [("sample", "A", []), ("sample_24", "B", ["--frames", "24", "--max-size", "240"]),
           ("sample_36", "A", ["--frames", "36", "--max-size", "320"]), ("testbed/case3", "B", []),
           ("testbed/case3_free", "A", ["--motion", "free"]),
           ("sample_10", "A", ["--frames", "10", "--max-size", "160"]), ("sample_12", "B", ["--frames", "12"]),
           ("sample_18", "A", ["--frames", "18", "--motion", "free"]), ("sample_30", "B", ["--frames", "30", "--motion", "free"]),
           ("testbed/case3_36", "B", ["--frames", "36", "--motion", "free"]), ("testbed/case3_60", "A", ["--frames", "60", "--motion", "free"])]
# Their frames as photos: how many.
SHIPPED_PHOTOS = [("sample", "A", 18), ("sample", "B", 36), ("testbed/case3", "A", 24), ("testbed/case3", "B", 36),
                  ("testbed/case3", "A", 48), ("testbed/case3", "B", 72)]
# Harder copies of captures of the suite.
THINNED = [("microphone-stand-full", 2), ("microphone-stand-full", 3), ("twins-stand-full", 2), ("twins-stand-full", 3),
           ("bust-stand-full", 2), ("chair-stand-full", 2), ("chair-stand-full", 3), ("statue-orbit-full", 3), ("chair-orbit-full", 3),
           ("mockup-orbit-full", 2), ("mockup-orbit-full", 3), ("product-orbit-full", 2), ("product-orbit-full", 3),
           ("hubble-orbit-sun", 2), ("hubble-orbit-sun", 3), ("chair-orbit-full", 2), ("statue-orbit-full", 2)]
DINO_STEP_DEG = 9.99


def thinned(images, every, folder):
    """A copy with every n-th image."""
    if not os.path.isdir(folder):
        os.makedirs(folder)
        for name in sorted(os.listdir(images))[::every]:
            shutil.copy(os.path.join(images, name), folder)
    return folder


def suite_inputs(cache, out):
    """Captures of the suite and of the made-wrong set, those of the latter's motions as well."""
    found = bench_suite.found_captures(cache)
    for name, entry in found.items():
        if entry["group"] == "wrong":
            entry["half"] = entry["case"].get("half", "A")
    for path in sorted(glob.glob(os.path.join(cache, "captures/*"))):
        capture = captures.parse(os.path.basename(path).rsplit("-", 1)[0]) if not path.endswith(".part") else None
        if capture and capture.motion in ("stand", "stage") and path == capture.folder(cache):
            half = "A" if capture.object == "twins" else capture.half
            found[capture.name] = {"folder": path, "half": half, "group": "extra", "input": os.path.join(path, "images"),
                                   "truths": {"body": os.path.join(path, "sparse")}}
    # Right or doubted, both are well: its photos state another lens. The others are the captures themselves.
    for name in ("wrong_exif", "repeated_mesh", "repeated_sides", "still_room", "textureless", "still_room_b", "still_room_chair", "repeated_craft"):
        found.pop("wrong/" + name, None)
    for name, every in THINNED:
        if name in found:
            entry, folder = found[name], os.path.join(out, "copies", f"{name}_every{every}")
            found[f"{name}_every{every}"] = entry | {"input": thinned(entry["input"], every, folder)}
    return found


def real_truth(shared, source):
    """{name without extension: (R, t)} of a real set."""
    if source is None:
        step = np.radians(DINO_STEP_DEG)
        names = [f"{k:03d}" for k in range(36)]
        turn = lambda a: np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])  # noqa: E731
        return {n: (turn(k * step), np.zeros(3)) for k, n in enumerate(names)}
    sys.path.insert(0, os.path.join(shared, "tools"))
    import compare_poses
    poses = compare_poses.read_ground_truth(os.path.join(shared, "data", source))
    return {os.path.splitext(os.path.basename(n))[0]: (p.R, p.t) for n, p in poses.items()}


def frames_of_video(binary, video, count, folder):
    """A folder with so many frames of a video."""
    if not os.path.isdir(folder):
        made = folder + ".run"
        subprocess.run([binary, "frames", video, "-o", made, "--frames", str(count)], check=True, stdout=subprocess.DEVNULL)
        shutil.move(os.path.join(made, "images"), folder)
        shutil.rmtree(made)
    return folder


def real_inputs(binary, shared, out):
    """Real sets and harder copies of them."""
    found = {}
    for name, (images, truth, half) in REAL.items():
        entry = {"half": half, "group": "real", "input": os.path.join(shared, "data", images), "real": name, "truths": {}}
        found["real/" + name] = entry
        for _, copy, options in [c for c in COPIES if c[0] == name]:
            folder = os.path.join(out, "copies", f"{name}_{copy}")
            if not os.path.isdir(folder):
                command = [sys.executable, os.path.join(shared, "tools/degrade.py"), entry["input"], folder, *options]
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            found[f"real/{name}_{copy}"] = entry | {"input": folder}
    for name, half, options in SHIPPED:
        folder, video, truth = os.path.join(TOOLS, "../data", name.split("_")[0]), *SHIPPED_FILES[name.split("_")[0]]
        found["shipped/" + name] = {"half": half, "group": "shipped", "input": os.path.join(folder, video),
                                    "truths": {"body": os.path.join(folder, truth)}, "options": options}
    for name, half, count in SHIPPED_PHOTOS:
        folder, video, truth = os.path.join(TOOLS, "../data", name), *SHIPPED_FILES[name]
        images = frames_of_video(binary, os.path.join(folder, video), count, os.path.join(out, "copies", f"{name.replace('/', '_')}_{count}_photos"))
        found[f"shipped/{name}_{count}_photos"] = {"half": half, "group": "shipped", "input": images,
                                                   "truths": {"body": os.path.join(folder, truth)}}
    return found


def dino_record(model, total):
    """A turn in steps of ten degrees, judged by the angles alone."""
    names = sorted(model)
    digits = lambda n: int("".join(c for c in n if c.isdigit()))  # noqa: E731
    angles = np.array([digits(n) for n in names]) * DINO_STEP_DEG
    i, j = np.triu_indices(len(names), 1)
    true = np.abs((angles[j] - angles[i] + 180) % 360 - 180)
    R = np.array([model[n][0] for n in names])
    found = judge.angles_deg(R[j] @ np.swapaxes(R[i], 1, 2))
    errors = np.abs(found - true)
    record = {"registered": len(names), "total": total, "pairs_median_deg": float(np.median(errors)),
              "images_off": float((errors > judge.WRONG_IMAGE_DEG).mean())}
    record["wrong"] = record["pairs_median_deg"] > judge.WRONG_PAIRS_DEG or record["images_off"] > judge.WRONG_IMAGES
    return record


def judged(folder, entry, names, shared):
    """Figures of a model against its truth."""
    model = judge.read_model(folder)
    if len(model) < 3:
        return {"registered": len(model), "total": len(names), "model": "none"}
    if entry.get("case", {}).get("asked") == "doubt":
        return {"registered": len(model), "total": len(names), "model": "wrong"}
    if entry.get("real") == "oxford_dino":
        record = dino_record(model, len(names))
    elif entry.get("real"):
        record = judge.judge(model, real_truth(shared, REAL[entry["real"]][1]), len(names))
    else:
        truths = {which: judge.read_model(path) for which, path in entry["truths"].items()}
        # Two objects at one place in one room are one scene: a model of both can be right.
        truths["all"] = {name: pose for truth in truths.values() for name, pose in truth.items()}
        record = judge.judge_any(model, truths, len(names))
    record["model"] = "wrong" if record.get("wrong", True) else "right"
    return record


def solve(binary, name, entry, out, shared):
    """A row: a capture solved and judged."""
    folder = os.path.join(out, "runs", name)
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(os.path.dirname(folder), exist_ok=True)
    with open(folder + ".log", "w") as log:
        command = [binary, "--threads", "1", "sfm", entry["input"], "-o", folder, *entry.get("options", [])]
        code, _, cpu, _ = bench.measured(command, stdout=log, stderr=log)
    run = judge.read_json(os.path.join(folder, "run.json"))
    row = {"capture": name, "half": entry["half"], "group": entry["group"], "exit": code, "cpu_s": round(cpu, 1)}
    names = bench_suite.frames_of(folder)
    record = judged(folder, entry, names, shared)
    row |= {k: record[k] for k in ("registered", "total", "model", "pairs_median_deg", "images_off") if k in record}
    decisions = (run.get("poses") or {}).get("decisions", [])
    found = next((d for d in decisions if d["subject"] == "plausibility"), None)
    if found:
        row["probability"] = found["choice"]["value"]["value"]
        row |= {m["quantity"]: m["value"] for m in found["measurements"]}
    motion, _ = bench_suite.motion_named(run)
    steps = {k: v for k, v in (run.get("poses") or {}).get("figures", []) if "plausibility" in k}
    row |= {"motion": motion, "judging_s": next(iter(steps.values()), None)}
    for part in ("images", "masks", "sparse_points.ply"):
        shutil.rmtree(os.path.join(folder, part), ignore_errors=True)
    return row


def write_table(rows, path):
    keys = list(dict.fromkeys(k for row in rows for k in row))
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, [k for k in keys if k != "program"], lineterminator="\n", extrasaction="ignore")
        writer.writeheader()
        for row in sorted(rows, key=lambda r: r["capture"]):
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--table", help="where the table is written")
    parser.add_argument("--cache", default=suite.cache_folder())
    args = parser.parse_args()
    program, results = bench_suite.digest(args.binary), os.path.join(args.out, "results")
    os.makedirs(results, exist_ok=True)
    rows = []
    for name, entry in (real_inputs(args.binary, args.shared, args.out) | suite_inputs(args.cache, args.out)).items():
        if args.only and not any(part in name for part in args.only):
            continue
        path = os.path.join(results, name.replace("/", "_") + ".json")
        row = judge.read_json(path)
        if row.get("program") != program:
            row = solve(args.binary, name, entry, args.out, args.shared) | {"program": program}
            with open(path, "w") as file:
                json.dump(row, file, indent=1)
            print(f"{name:32} exit {row['exit']} {row['model']:6} {row.get('registered')}/{row.get('total')} "
                  f"{row.get('pairs_median_deg', float('nan')):7.2f}° p {row.get('probability')} {row['cpu_s']} s", flush=True)
        rows.append(row)
    if args.table:
        write_table(rows, args.table)


if __name__ == "__main__":
    main()
