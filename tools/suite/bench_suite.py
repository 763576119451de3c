#!/usr/bin/env python3
"""Runs sat-recon on the captures of the suite that are made, and on the made-wrong set.

    bench_suite.py SAT_RECON --out FOLDER [--only PART ...] [--colmap] [--tool TOOL] [--table]

One JSON file a capture in FOLDER/results: it is not run again with the same program, so a run can
be stopped and started. `--only` takes parts of names (`wrong` for the made-wrong set); `--table`
prints what is there and runs nothing. Beside it, with `--colmap`, COLMAP 4.2.1 on the same frames
(needs pycolmap). Half A of the objects may be used to choose things, half B never: the tables show
both apart.
"""
import argparse
import glob
import hashlib
import json
import os
import shutil
import subprocess
import sys

import captures
import judge
import judge_motion
import suite
import suite_tables
import truth

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, ".."))
import bench  # noqa: E402

LAST_LINES = 12  # of what the program said that are kept


def digest(path):
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()[:12]


def found_captures(cache):
    """{name: (folder, input, half, {truth: model})} of what is made, suite and made-wrong set."""
    found = {}
    for capture in captures.all_captures():
        folder = capture.folder(cache)
        if os.path.isdir(folder):
            found[capture.name] = dict(folder=folder, half=capture.half, group="suite", truths={"body": os.path.join(folder, "sparse")})
    for path in sorted(glob.glob(os.path.join(cache, "wrong", f"*-{captures.REVISION}", "case.json"))):
        with open(path) as file:
            case = json.load(file)
        folder = os.path.dirname(path)
        truths = {os.path.basename(p): p for p in glob.glob(os.path.join(folder, "truths/*"))}
        found["wrong/" + case["name"]] = dict(folder=folder, half="-", group="wrong", truths=truths, case=case)
    for entry in found.values():
        video = os.path.join(entry["folder"], "video.mp4")
        entry["input"] = video if os.path.isfile(video) else os.path.join(entry["folder"], "images")
    return found


def stated(code):
    """What an exit code says of the model."""
    return {0: "well", 3: "doubtful"}.get(code, "refused")


def motion_named(run):
    """What the program took the motion for, and whether it says that a turn is steady."""
    decisions = (run.get("poses") or {}).get("decisions", [])
    motion = next((d["choice"].get("motion") for d in decisions if d["subject"] == "motion"), None)
    rates = {m["quantity"]: m["value"] for d in decisions if d["subject"] == "rotation-rate" for m in d["measurements"]}
    steady = rates["smoothed-deviation"] < STEADY_DEG if "smoothed-deviation" in rates else None
    return motion, steady if motion == "single-axis" else None


STEADY_DEG = 0.02  # deviation from one rate that is left where a turn was taken for steady


def run_program(binary, name, entry, out):
    """A row: what `sat-recon sfm` makes of a capture."""
    folder = os.path.join(out, "runs", name)
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(os.path.dirname(folder), exist_ok=True)
    with open(folder + ".log", "w") as log:
        code, wall, cpu, peak = bench.measured([binary, "sfm", entry["input"], "-o", folder], stdout=log, stderr=log)
    with open(folder + ".log") as log:
        said = [line for line in log.read().splitlines() if line.strip()][-LAST_LINES:]
    run = judge.read_json(os.path.join(folder, "run.json"))
    row = {"capture": name, "tool": "sat-recon", "exit": code, "stated": stated(code), "cpu_s": cpu, "wall_s": wall, "peak_mib": peak,
           "said": said, "lights": run.get("verdict", [])}
    row["motion_named"], row["steady_named"] = motion_named(run)
    return row | judged(folder, entry, frames_of(folder), run)


def frames_of(folder):
    images = os.path.join(folder, "images")
    return [os.path.splitext(n)[0] for n in sorted(os.listdir(images))] if os.path.isdir(images) else []


def judged(model_folder, entry, names, run):
    """Figures of the poses in a folder against the capture's truths."""
    model = judge.read_model(model_folder)
    truths = {which: judge.read_model(path) for which, path in entry["truths"].items()}
    # Two objects at one place in one room are one scene: a model of both can be right.
    truths["all"] = {name: pose for truth in truths.values() for name, pose in truth.items()}
    record = judge.judge_any(model, truths, len(names))
    record["model"] = "none" if len(model) < 3 else "wrong" if record.get("wrong", True) else "right"
    if entry.get("case", {}).get("asked") == "doubt" and model:
        record["model"] = "impossible"
    if entry["group"] != "suite":
        return record
    motion = judge.read_json(os.path.join(entry["folder"], "motion.json"))
    record["true_motion"] = motion["type"]
    if motion["type"] in ("steady turn", "turn by hand"):
        record |= judge.turn_figures(model_folder, entry["truths"]["body"], names)
    if "fps" in motion:
        record |= judge_motion.every_frame(model_folder, entry["truths"]["body"], motion["fps"])
    record |= judge_motion.report(run, motion)
    images = ((run.get("poses") or {}).get("deviations") or {}).get("images", [])
    record["deviation_ratios"] = judge.deviation_ratios(model, truths["body"], [i for i in images if i])
    camera = (run.get("poses") or {}).get("cameras")
    return record | ({"cameras": camera} if camera else {})


def run_colmap(_binary, name, entry, out):
    """A row of COLMAP 4.2.1's incremental mapper on the photos, or on the frames that sat-recon took."""
    ours, folder = os.path.join(out, "runs", name), os.path.abspath(os.path.join(out, "colmap", name))
    is_video = entry["input"].endswith(".mp4")
    images = os.path.abspath(os.path.join(ours, "images") if is_video else entry["input"])
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    frames = (judge.read_json(os.path.join(ours, "run.json")).get("frames") or {}).get("frames", [])
    masks = ""
    for frame in frames:
        if frame.get("mask"):
            masks = folder + ".masks"
            os.makedirs(masks, exist_ok=True)
            link = os.path.join(masks, frame["name"] + ".png")
            if not os.path.lexists(link):
                os.symlink(os.path.join(os.path.abspath(ours), "masks", os.path.basename(frame["mask"])), link)
    program = "import sys; sys.path.insert(0, sys.argv[1]); import compare; compare.MAPPERS = compare.MAPPERS[:1]; compare.pycolmap_models(*sys.argv[2:5], '')"
    with open(folder + ".log", "w") as log:
        command = [sys.executable, "-c", program, os.path.join(HERE, ".."), images, folder, masks]
        code, wall, cpu, peak = bench.measured(command, stdout=log, stderr=log)
    row = {"capture": name, "tool": "COLMAP 4.2.1", "exit": code, "stated": "-", "cpu_s": cpu, "wall_s": wall, "peak_mib": peak}
    return row | judged(os.path.join(folder, "incremental"), entry, frames_of(os.path.dirname(images)), {})


TOOLS = {"sat-recon": run_program, "colmap": run_colmap}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--colmap", action="store_true")
    parser.add_argument("--tool", choices=TOOLS, help="only this one")
    parser.add_argument("--table", action="store_true", help="print the tables of what is there, run nothing")
    parser.add_argument("--cache", default=suite.cache_folder())
    args = parser.parse_args()
    program, results = digest(args.binary), os.path.join(args.out, "results")
    rows = []
    for name, entry in found_captures(args.cache).items():
        if args.only and not any(part in name for part in args.only):
            continue
        for tool, run in TOOLS.items():
            if args.tool and tool != args.tool:
                continue
            path = os.path.join(results, f"{name.replace('/', '_')}.{tool}.json")
            row = judge.read_json(path)
            wanted = tool == "sat-recon" and row.get("program") != program or tool == "colmap" and args.colmap and not row
            if wanted and not args.table:
                row = run(args.binary, name, entry, args.out)
                row |= {"program": program, "half": entry["half"], "group": entry["group"], "asked": entry.get("case", {}).get("asked")}
                os.makedirs(results, exist_ok=True)
                with open(path, "w") as file:
                    json.dump(row, file, indent=1)
                print(suite_tables.line(row), file=sys.stderr, flush=True)
            if row:
                rows.append(row)
    print(suite_tables.tables(rows))


if __name__ == "__main__":
    main()
