#!/usr/bin/env python3
"""Our poses beside COLMAP 3.8 (Debian) and 4.2.1 (pycolmap, incremental and global) on the same images.

    compare.py SAT_RECON SHARED --out FOLDER [--only NAME ...]

Each tool runs with its defaults, one camera, exhaustive matching, on the CPU. Costs are CPU seconds.
"""
import argparse
import os
import resource
import shutil
import sys

import bench

SETS = [entry for entry in bench.POSES if entry[2]]


def pycolmap_models(images, folder):
    """Runs in a process of its own, so that its cost can be told."""
    import pycolmap

    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    database = os.path.join(folder, "database.db")
    pycolmap.extract_features(database, images, camera_mode=pycolmap.CameraMode.SINGLE)
    pycolmap.match_exhaustive(database)
    for name, mapping in (("incremental", pycolmap.incremental_mapping), ("global", pycolmap.global_mapping)):
        before = resource.getrusage(resource.RUSAGE_SELF)
        os.makedirs(os.path.join(folder, name))
        mapping(database, images, os.path.join(folder, name))
        after = resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        with open(os.path.join(folder, name + ".cpu"), "w") as file:
            file.write(str(cpu))


def best_model(binary, folder, truth):
    models = [os.path.join(folder, m) for m in sorted(os.listdir(folder)) if os.path.isdir(os.path.join(folder, m))]
    records = [bench.pose_errors(binary, m, truth) for m in models]
    return max(records, key=lambda r: r["registered"], default=dict(registered=0, total=0))


def run_pycolmap(args, mapper):
    """For bench.py's table of turns: a function of images and folder that returns the folder of models and the CPU s."""
    def run(images, folder):
        images = os.path.abspath(images)
        command = [sys.executable, __file__, args.binary, args.shared, "--out", args.out, "--pycolmap", images, folder]
        with open(os.devnull, "w") as null:
            code, _, cpu, _ = bench.measured(command, stdout=null, stderr=null)
        if code != 0:
            return folder, cpu
        others = {"incremental": "global", "global": "incremental"}
        with open(os.path.join(folder, others[mapper] + ".cpu")) as file:
            cpu -= float(file.read())
        return os.path.join(folder, mapper), cpu
    return run


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--pycolmap", nargs=2, metavar=("IMAGES", "FOLDER"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.pycolmap:
        return pycolmap_models(*args.pycolmap)
    only = args.only or [entry[0] for entry in SETS]
    bench.bench_poses(args.binary, args.shared, args.out, only, colmap=only)
    for name, _, truth, _ in SETS:
        if name not in only:
            continue
        images = os.path.join(args.out, "poses", name, "images")
        folder = os.path.join(args.out, "pycolmap", name)
        command = [sys.executable, __file__, args.binary, args.shared, "--out", args.out, "--pycolmap", images, folder]
        with open(os.devnull, "w") as null:
            code, wall, cpu, peak = bench.measured(command, stdout=null, stderr=null)
        if code != 0:
            print(f"| {name} | COLMAP 4.2.1 | failed with exit code {code} |")
            continue
        costs = {}
        for mapper in ("incremental", "global"):
            with open(os.path.join(folder, mapper + ".cpu")) as file:
                costs[mapper] = float(file.read())
        for mapper, other in (("incremental", "global"), ("global", "incremental")):
            record = best_model(args.binary, os.path.join(folder, mapper), os.path.join(args.shared, "data", truth))
            bench.pose_row(name, f"COLMAP 4.2.1 {mapper}", record, cpu - costs[other], wall, peak)
    tools = [("COLMAP 3.8", lambda images, folder: bench.run_colmap(images, folder)[:2])]
    tools += [(f"COLMAP 4.2.1 {m}", run_pycolmap(args, m)) for m in ("incremental", "global")]
    bench.bench_turns(args.binary, args.shared, args.out, args.only, tools)


if __name__ == "__main__":
    main()
