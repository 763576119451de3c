#!/usr/bin/env python3
"""Our poses beside COLMAP 3.8 (Debian) and 4.2.1 (pycolmap, incremental and global) on the same
images.

    compare.py SAT_RECON SHARED --out FOLDER [--only NAME ...] [--tools 3.8 4.2.1 database] [--turns]

Each tool runs with its defaults, one camera, exhaustive matching, on the CPU; where our frames
have masks (the yaw), once on the frames as they are and once inside the masks. "on our database":
its mapper on features and matches that we found (`--colmap-database`), its cost that of mapping
alone. Costs are CPU seconds. Every model is judged by `sat-recon compare --truth`, and the
agreement of a mapper on our database with our own model by SHARED/tools/compare_poses.py. With
--turns the tools also run on the turns of the test bed, angles judged. The rows are left in
FOLDER/results as JSON, too.
"""
import argparse
import json
import os
import resource
import shutil
import subprocess
import sys

import bench
from bench_results import Results

SETS = [entry for entry in bench.POSES if entry[2]]
# What `make testbed` renders, where it has been.
RENDERED = [(name, os.path.join(case, "images"), os.path.join(case, "sparse"), []) for name, case in bench.ORBITS]
RENDERED += [(name, os.path.join(case, "video.mp4"), os.path.join(case, "sparse"), []) for name, case in bench.TURNS[1:]]
MAPPERS = ("incremental", "global")


def cpu():
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def pycolmap_models(images, folder, masks, database):
    """Runs in a process of its own, so that its cost can be told: costs.json beside the models."""
    import pycolmap

    costs = {"before": cpu()}
    if not database:
        database = os.path.join(folder, "database.db")
        reader = pycolmap.ImageReaderOptions()
        if masks:
            reader.mask_path = masks
        pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader)
        pycolmap.match_exhaustive(database)
    costs["features and matches"] = cpu() - costs["before"]
    for name, mapping in zip(MAPPERS, (pycolmap.incremental_mapping, pycolmap.global_mapping)):
        before = cpu()
        os.makedirs(os.path.join(folder, name))
        mapping(database, images, os.path.join(folder, name))
        costs[name] = cpu() - before
    with open(os.path.join(folder, "costs.json"), "w") as file:
        json.dump(costs, file)


def best_model(binary, folder, truth, names):
    models = [os.path.join(folder, m) for m in sorted(os.listdir(folder)) if os.path.isdir(os.path.join(folder, m))]
    records = [bench.pose_errors(binary, m, truth) | {"model": m} for m in models]
    best = max(records, key=lambda r: r["registered"], default=dict(registered=0))
    return best | {"total": names}


def colmap_421(binary, name, images, truth, folder, table, masks=None, database=None):
    """Rows of both mappers; the folder of the incremental mapper's best model."""
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    command = [sys.executable, os.path.abspath(__file__), binary, "", "--out", "", "--pycolmap", images, folder, masks or "", database or ""]
    with open(os.path.join(folder, "log"), "w") as log:
        code, wall, _, peak = bench.measured(command, stdout=log, stderr=log)
    how = " on our database" if database else ", inside the masks" if masks else ""
    if code != 0:
        print(f"COLMAP 4.2.1{how} on {name} failed with exit code {code}, see {folder}/log", file=sys.stderr)
        return None
    with open(os.path.join(folder, "costs.json")) as file:
        costs = json.load(file)
    best = None
    for mapper in MAPPERS:
        record = best_model(binary, os.path.join(folder, mapper), truth, len(os.listdir(images)))
        spent = costs["features and matches"] + costs[mapper]
        table.row(record | dict(input=name, tool=f"COLMAP 4.2.1 {mapper}{how}", cpu_s=spent, wall_s=wall, peak_mib=peak))
        best = best or record.get("model")
    return best


def mask_links(run, folder):
    """COLMAP looks for the mask of a.png as a.png.png; None where the run has no masks."""
    shutil.rmtree(folder, ignore_errors=True)
    with open(os.path.join(run, ".stages/frames.json")) as file:
        frames = json.load(file)["value"]["frames"]
    for frame in frames:
        if frame["mask"]:
            link = os.path.join(folder, frame["name"] + ".png")
            os.makedirs(os.path.dirname(link), exist_ok=True)
            os.symlink(os.path.abspath(os.path.join(run, frame["mask"])), link)
    return folder if os.path.isdir(folder) else None


def truth_of_frames(truth, images, folder):
    """The truth of a video knows all of its frames: that of the chosen ones."""
    if not os.path.isfile(os.path.join(truth, "images.txt")):
        return truth
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(truth, folder)
    chosen = set(os.listdir(images))
    with open(os.path.join(truth, "images.txt")) as file:
        lines = [line for line in file if not line.startswith("#")]
    with open(os.path.join(folder, "images.txt"), "w") as file:
        for pose, points in zip(lines[::2], lines[1::2]):
            if pose.split()[-1] in chosen:
                file.write(pose + points)
    return folder


def agreement(shared, tool, model, ours):
    judge = [sys.executable, os.path.join(shared, "tools/compare_poses.py"), model, "--gt", ours]
    said = subprocess.run(judge, capture_output=True, text=True)
    print(f"\n{tool} against our model, compare_poses.py:\n```\n{said.stdout.strip() or said.stderr.strip()}\n```\n", flush=True)


def on_our_database(binary, shared, out, name, source, truth, flags, table):
    """The mappers of 3.8 and 4.2.1 on features and matches of ours."""
    run = os.path.join(out, "database", name)
    shutil.rmtree(run, ignore_errors=True)
    subprocess.run([binary, "sfm", source, "-o", run, "-q", "--ignore-poses", "--colmap-database", *flags], check=True)
    images, database = os.path.join(run, "images"), os.path.join(run, "database.db")
    copies = [os.path.join(out, "database", f"{name}-{version}.db") for version in ("3.8", "4.2.1")]
    for copy in copies:
        shutil.copyfile(database, copy)  # a newer COLMAP brings the tables up to date, which older ones do not read
    old = bench.bench_colmap(binary, name, images, truth, os.path.join(out, "database", name + "-3.8"), table, database=copies[0])
    new = colmap_421(binary, name, images, truth, os.path.join(out, "database", name + "-4.2.1"), table, database=copies[1])
    for tool, model in (("COLMAP 3.8", old), ("COLMAP 4.2.1", new)):
        if model:
            agreement(shared, f"{name}: {tool} on our database", model, os.path.join(run, "sparse/0"))


def run_pycolmap(args, mapper):
    """For bench.py's table of turns: a function of images and folder that returns the folder of
    models and the CPU s."""
    def run(images, folder):
        shutil.rmtree(folder, ignore_errors=True)
        os.makedirs(folder)
        command = [sys.executable, __file__, args.binary, "", "--out", "", "--pycolmap", os.path.abspath(images), folder, "", ""]
        with open(os.path.join(folder, "log"), "w") as log:
            code, _, cpu, _ = bench.measured(command, stdout=log, stderr=log)
        if code != 0:
            return folder, cpu
        with open(os.path.join(folder, "costs.json")) as file:
            costs = json.load(file)
        return os.path.join(folder, mapper), costs["features and matches"] + costs[mapper]
    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--tools", nargs="*", default=["3.8", "4.2.1", "database"], choices=["3.8", "4.2.1", "database"])
    parser.add_argument("--turns", action="store_true", help="the turns of the test bed too (slow)")
    parser.add_argument("--pycolmap", nargs=4, metavar=("IMAGES", "FOLDER", "MASKS", "DATABASE"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.pycolmap:
        return pycolmap_models(*args.pycolmap)
    sets = SETS + [entry for entry in RENDERED if os.path.exists(entry[1])]
    only = args.only or [entry[0] for entry in sets]
    results = Results(os.path.join(args.out, "results"))
    table = results.table("compare")
    bench.bench_poses(args.binary, args.shared, args.out, only, [], table, sets=sets)
    for name, source, truth, flags in sets:
        if name not in only:
            continue
        source, truth = (os.path.join(args.shared, "data", path) for path in (source, truth))
        run = os.path.join(args.out, "poses", name)
        images = os.path.join(run, "images")
        truth = truth_of_frames(truth, images, os.path.join(args.out, "truth", name))
        masks = mask_links(run, os.path.join(args.out, "masks", name))
        for how, folder in ((None, name), (masks, name + ", inside the masks")) if masks else ((None, name),):
            if "3.8" in args.tools:
                bench.bench_colmap(args.binary, name, images, truth, os.path.join(args.out, "colmap", folder), table, masks=how)
            if "4.2.1" in args.tools:
                colmap_421(args.binary, name, images, truth, os.path.join(args.out, "pycolmap", folder), table, masks=how)
        if "database" in args.tools:
            on_our_database(args.binary, args.shared, args.out, name, source, truth, flags, table)
    if args.turns:
        tools = [("COLMAP 3.8", lambda images, folder: bench.run_colmap(images, folder)[:2])]
        tools += [(f"COLMAP 4.2.1 {m}", run_pycolmap(args, m)) for m in MAPPERS]
        bench.bench_turns(args.binary, args.out, args.only, tools, results.table("turns"))


if __name__ == "__main__":
    main()
