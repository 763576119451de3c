#!/usr/bin/env python3
"""Runs sat-recon on the real captures and the test bed: the tables of docs/benchmarks.md.

    bench.py SAT_RECON SHARED --out FOLDER [--tables NAME ...] [--only INPUT ...] [--colmap INPUT ...]

Prints each table and leaves it in FOLDER/results as JSON, from which benchmarks_page.py makes the
page. Poses are judged by `sat-recon compare --truth`: the area under the recall curve over all
image pairs. COLMAP 3.8 runs on the same images in the same call where it is installed. Costs are
CPU seconds (user and system, subprocesses included) and peak resident memory.
"""
import argparse
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import time

import bench_sfm
import bench_splats
import bench_whole
import turntable
from bench_results import Results

TESTBED = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../data/testbed")
POSES = [
    # name, input below SHARED/data, truth below SHARED/data, flags
    ("temple_ring", "temple_ring/images", "temple_ring/cameras_par.txt", []),
    ("fountain_p11", "fountain_p11/images", "fountain_p11/gt_dense_cameras", []),
    ("fox", "fox/images", "fox/transforms.json", []),
    ("oxford_dino", "oxford_dino/images", None, []),
    ("can_orbit", "phone_video/can_orbit.mp4", None, []),
    ("yaw, 10 % light (case 3)", os.path.join(TESTBED, "case3/video.mp4"), os.path.join(TESTBED, "case3/sparse"), []),
]
# Harder copies of temple_ring, made by SHARED/tools/degrade.py (which needs numpy, pillow and
# scipy).
VARIANTS = [
    ("every 2nd image", "--every 2"), ("every 3rd image", "--every 3"), ("every 4th image", "--every 4"),
    ("every 5th image", "--every 5"), ("masked to black", "--mask"), ("masked, x 0.1, 8 bit", "--mask --gain 0.1"),
    ("masked, x 0.1 + noise 3", "--mask --gain 0.1 --noise 3"), ("masked, x 0.1 + noise 3, x 10", "--mask --gain 0.1 --noise 3 --regain 10"),
    ("masked, x 0.25 + noise 3", "--mask --gain 0.25 --noise 3"), ("x 2, clipped", "--gain 2"), ("x 4, clipped", "--gain 4"),
]
# Turns about one axis: name, video below the test bed, truth. `make testbed` renders case 4.
RENDERED = os.path.join(TESTBED, "../../build/testbed")
TURNS = [
    ("yaw, 10 % light (case 3)", os.path.join(TESTBED, "case3")),
    ("yaw, 100 % light (case 4)", os.path.join(RENDERED, "case4")),
]
# Orbits in a dark room; `make testbed` renders them.
ORBITS = [("orbit, 10 % light (case 1)", os.path.join(RENDERED, "case1")), ("orbit, 100 % light (case 2)", os.path.join(RENDERED, "case2"))]

TABLES = ["poses", "variants", "dino", "steps", "orbits", "turns", "quality", "rings", "key", "features",
          "splats", "times", "packed", "whole", "shapes", "ablation", "step", "growth"]

def measured(command, **options):
    """Runs a command; returns exit code, wall seconds, CPU seconds and peak MiB of its
    processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.time()
    process = subprocess.Popen(command, **options)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.time() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return os.waitstatus_to_exitcode(status), wall, cpu, usage.ru_maxrss / 1024


def run_json(command):
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def pose_errors(binary, model, truth):
    """Errors of a model as fields of a row."""
    record = run_json([binary, "compare", model, "--truth", truth, "--json"])[0]
    record |= {f"auc_{degrees}": value for degrees, value in (record.pop("auc", None) or {}).items()}
    return record


def solve(binary, source, folder, flags, truth):
    """A row: what `sat-recon sfm` makes of images or a video, and what it costs."""
    shutil.rmtree(folder, ignore_errors=True)
    code, wall, cpu, peak = measured([binary, "sfm", source, "-o", folder, "-q", *flags])
    with open(os.path.join(folder, "run.json")) as file:
        poses = json.load(file)["poses"]
    row = dict(tool="sat-recon", registered=poses["registered"], total=poses["total"])
    if truth and code in (0, 3):
        row |= pose_errors(binary, folder, truth)
    return row | dict(cpu_s=cpu, wall_s=wall, peak_mib=peak)


def bench_poses(binary, shared, out, only, colmap, table, sets=POSES):
    for name, source, truth, flags in sets:
        if only and name not in only:
            continue
        folder = os.path.join(out, "poses", name)
        source = os.path.join(shared, "data", source)
        truth = truth and os.path.join(shared, "data", truth)
        table.row(solve(binary, source, folder, ["--ignore-poses", *flags], truth) | dict(input=name))
        if name in colmap and truth and shutil.which("colmap"):
            bench_colmap(binary, name, os.path.join(folder, "images"), truth, os.path.join(out, "colmap", name), table)


def bench_variants(binary, shared, out, only, table):
    truth = os.path.join(shared, "data/temple_ring/cameras_par.txt")
    for i, (name, options) in enumerate(VARIANTS):
        if only and name not in only:
            continue
        images, folder = (os.path.join(out, part, str(i)) for part in ("inputs", "variants"))
        shutil.rmtree(images, ignore_errors=True)
        subprocess.run([sys.executable, os.path.join(shared, "tools/degrade.py"), os.path.join(shared, "data/temple_ring/images"),
                        images, *options.split()], check=True, stdout=subprocess.DEVNULL)
        table.row(solve(binary, images, folder, [], truth) | dict(input=name))


def run_colmap(images, folder, masks=None, database=None):
    """Debian's COLMAP 3.8 with its defaults, one camera, on the CPU; its mapper alone where a
    database is given: (folder of models, CPU s, wall s, peak MiB)."""
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(os.path.join(folder, "sparse"))
    environment = dict(os.environ, QT_QPA_PLATFORM="offscreen")
    given, database = database, database or os.path.join(folder, "database.db")
    steps = [
        ["feature_extractor", "--image_path", images, "--ImageReader.single_camera", "1", "--SiftExtraction.use_gpu", "0",
         *(["--ImageReader.mask_path", masks] if masks else [])],
        ["exhaustive_matcher", "--SiftMatching.use_gpu", "0"],
        ["mapper", "--image_path", images, "--output_path", os.path.join(folder, "sparse")],
    ]
    total_cpu = total_wall = most = 0.0
    with open(os.path.join(folder, "log"), "w") as log:
        for step in steps[2:] if given else steps:
            command = ["colmap", step[0], "--database_path", database, *step[1:]]
            code, wall, cpu, peak = measured(command, env=environment, stdout=log, stderr=log)
            total_cpu, total_wall, most = total_cpu + cpu, total_wall + wall, max(most, peak)
            if code != 0 and step[0] != "mapper":  # which fails where it finds no model
                print(f"colmap {step[0]} failed, see {folder}/log", file=sys.stderr)
                break
    return os.path.join(folder, "sparse"), total_cpu, total_wall, most


def bench_colmap(binary, name, images, truth, folder, table, masks=None, database=None):
    """A row of COLMAP 3.8; the folder of its largest model."""
    sparse, cpu, wall, peak = run_colmap(images, folder, masks, database)
    tool = "COLMAP 3.8" + (" on our database" if database else ", inside the masks" if masks else "")
    models = [os.path.join(sparse, m) for m in sorted(os.listdir(sparse))]
    records = [pose_errors(binary, m, truth) | {"model": m} for m in models]
    best = max(records, key=lambda r: r["registered"], default=dict(registered=0)) | {"total": len(os.listdir(images))}
    table.row(best | dict(input=name, tool=tool, cpu_s=cpu, wall_s=wall, peak_mib=peak))
    return best.get("model")


def calibrated(binary, out, kind):
    """Flags that give the camera as photos taken with it by hand calibrate it; none where they are
    not rendered."""
    images = os.path.join(RENDERED, f"calibration_{kind}", "images")
    folder = os.path.join(out, f"calibration_{kind}")
    if not os.path.isdir(images):
        return []
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([binary, "sfm", images, "-o", folder, "-q"], check=True)
    return ["--camera-from", folder]


def turn_row(table, name, tool, model, truth, total, cpu):
    """One line of the table of turns; `model`: a folder, or None where there is none."""
    try:
        poses = turntable.read_poses(turntable.model_folder(model))
    except (SystemExit, OSError):
        poses = {}
    record, _ = turntable.judge(poses, {n: truth[n] for n in total}, len(total))
    table.row(record | dict(input=name, tool=tool, cpu_s=cpu))


def bench_turns(binary, out, only, tools, table):
    """Turns of the test bed: what is known, and how many frames are taken; `tools` are run
    beside."""
    for name, case in TURNS:
        if (only and name not in only) or not os.path.isfile(os.path.join(case, "video.mp4")):
            continue
        truth = turntable.read_poses(os.path.join(case, "sparse"))
        video, folder = os.path.join(case, "video.mp4"), os.path.join(out, "turns", os.path.basename(case))
        shutil.rmtree(folder, ignore_errors=True)
        known = ["--camera-model", "RADIAL", "--intrinsics", true_intrinsics(case)]
        ways = [("", []), (", intrinsics known", known), (", camera from 32 photos", calibrated(binary, out, "video")),
                (", 144 frames", ["--frames", "144"]), (", 216 frames", ["--frames", "216"])]
        for how, flags in ways:
            if how and not flags:
                continue
            run = os.path.join(folder, "sat-recon" + how)
            _, _, cpu, _ = measured([binary, "sfm", video, "-o", run, "-q", *flags])
            frames = [os.path.splitext(f)[0] for f in sorted(os.listdir(os.path.join(run, "images")))]
            turn_row(table, name, "sat-recon" + how, run, truth, frames, cpu)
        if not tools:
            continue
        mattes, raw = os.path.join(folder, "sat-recon/images"), os.path.join(folder, "raw/images")
        frames = [os.path.splitext(f)[0] for f in sorted(os.listdir(mattes))]
        subprocess.run([binary, "frames", video, "-o", os.path.dirname(raw), "-q", "--key", "off"], check=True)
        for kind, images in (("raw", raw), ("mattes", mattes)):
            for tool, run in tools:
                models, cpu = run(images, os.path.join(folder, f"{tool} {kind}"))
                turn_row(table, name, f"{tool}, {kind}", models, truth, frames, cpu)


def bench_orbits(binary, out, only, colmap, table):
    """Stills of an orbit, nothing known and with the camera calibrated; COLMAP 3.8 beside."""
    for name, case in ORBITS:
        if (only and name not in only) or not os.path.isdir(case):
            continue
        images, truth = os.path.join(case, "images"), os.path.join(case, "sparse")
        known = ["--camera-model", "RADIAL", "--intrinsics", true_intrinsics(case)]
        ways = [("", []), (", intrinsics known", known), (", camera from 32 photos", calibrated(binary, out, "stills"))]
        for how, flags in ways:
            if how and not flags:
                continue
            row = solve(binary, images, os.path.join(out, "orbits", name + how), flags, truth)
            table.row(row | dict(input=name, tool="sat-recon" + how))
        if colmap and shutil.which("colmap"):
            bench_colmap(binary, name, images, truth, os.path.join(out, "colmap", name), table)


def true_intrinsics(case):
    with open(os.path.join(case, "sparse/cameras.txt")) as file:
        line = [line for line in file if not line.startswith("#")][0]
    return ",".join(line.split()[4:])


def bench_steps(binary, shared, out, table):
    """oxford_dino, whose steps are 10 degrees: in its order, and with names that shuffle it."""
    images = os.path.join(shared, "data/oxford_dino/images")
    names = sorted(os.listdir(images))
    order = random.Random(7).sample(range(len(names)), len(names))
    for name, mix in (("oxford_dino", False), ("oxford_dino, shuffled", True)):
        folder = os.path.join(out, "steps", name)
        shutil.rmtree(folder, ignore_errors=True)
        source = images
        if mix:
            source = os.path.join(folder, "photos")
            os.makedirs(source)
            for k, i in enumerate(order):
                shutil.copy(os.path.join(images, names[i]), os.path.join(source, f"{k:03d}-{names[i]}"))
        code, _, cpu, _ = measured([binary, "sfm", source, "-o", os.path.join(folder, "out"), "-q"])
        with open(os.path.join(folder, "out/run.json")) as file:
            run = json.load(file)
        row = dict(input=name, registered=0, total=len(names), cpu_s=cpu)
        row["motion"] = next((d["choice"] for d in run["decisions"] if d["title"] == "Motion"), None)
        if code in (0, 3):
            model = turntable.read_poses(turntable.model_folder(os.path.join(folder, "out")))
            row |= turntable.steps(model, mix)
        table.row(row)


def printed(results, names, examples, example, *runs, **options):
    """Tables that an example of the workspace prints; `runs` are its arguments, call by call."""
    program = os.path.join(examples, example)
    if not os.path.exists(program):
        print(f"\n{example}: not measured: cargo build --release --locked --workspace --example {example}")
        return
    said = [subprocess.run([program, *run], check=True, capture_output=True, text=True, **options).stdout for run in runs]
    results.printed(names, "\n".join(said))


def bench_key(results, examples, shared):
    """Mattes against their truth, beside the plain rule and ffmpeg's chromakey."""
    cases = [os.path.join(TESTBED, "case3")] + [os.path.join(RENDERED, c) for c in ("case4", "blue/case3", "blue/case4")]
    cases = [c for c in cases if os.path.exists(os.path.join(c, "video.mp4"))]
    environment = dict(os.environ, SAT_RECON_SHARED=os.path.abspath(shared))
    printed(results, ["key"], examples, "key_table", cases, ["--no-head"], env=environment)


def bench_features(results, examples):
    """Beside the features of OpenCV and COLMAP that `make oracle` leaves."""
    oracle = os.path.join(TESTBED, "../../build/oracle")
    if os.path.isdir(oracle):
        printed(results, ["features", "views"], examples, "features_table", [oracle])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--results", help="folder of the JSON results (default: OUT/results)")
    parser.add_argument("--only", nargs="*", help="names of inputs")
    parser.add_argument("--tables", nargs="*", default=TABLES, choices=TABLES)
    parser.add_argument("--rings", nargs="*", type=int, default=[100, 300, 1000], help="images of the simulated rings")
    parser.add_argument("--examples", help="folder with the examples (default: beside SAT_RECON)")
    parser.add_argument("--plot", help="where the SVG of speed against accuracy goes (default: below --out)")
    parser.add_argument("--colmap", nargs="*", default=["temple_ring"], help="inputs on which COLMAP 3.8 runs too")
    parser.add_argument("--quality", nargs="*", default=["draft", "fast", "balanced"])
    parser.add_argument("--times", default="60s", help="time limits of training, such as 30s,60s")
    args = parser.parse_args()
    if not os.path.isdir(os.path.join(args.shared, "data")):
        sys.exit(f"{args.shared}/data is missing: the benchmarks need the real captures")
    os.makedirs(args.out, exist_ok=True)
    here = sys.modules[__name__]
    results = Results(args.results or os.path.join(args.out, "results"))
    examples = args.examples or os.path.join(os.path.dirname(os.path.abspath(args.binary)), "examples")
    binary, shared, out, only = args.binary, args.shared, args.out, args.only
    plot = args.plot or os.path.join(out, "speed_accuracy.svg")
    lego = os.path.join(shared, "data/lego400")
    run = {
        "poses": lambda t: bench_poses(binary, shared, out, only, args.colmap, t),
        "variants": lambda t: bench_variants(binary, shared, out, only, t),
        "orbits": lambda t: bench_orbits(binary, out, only, args.colmap, t),
        "turns": lambda t: bench_turns(binary, out, only, [], t),
        "steps": lambda t: bench_steps(binary, shared, out, t),
        "dino": lambda t: bench_sfm.bench_dino(here, binary, shared, out, t),
        "quality": lambda t: bench_sfm.bench_quality(here, binary, shared, out, plot, t),
        "rings": lambda t: bench_sfm.bench_growth(here, os.path.join(examples, "ring_growth"), args.rings, t),
        "splats": lambda t: bench_splats.bench_presets(here, binary, shared, out, only, args.quality, t),
        "times": lambda t: bench_splats.bench_times(here, binary, shared, out, only, args.times, t),
        "whole": lambda t: bench_whole.bench_whole(here, binary, shared, out, args.quality, os.path.join(os.path.dirname(plot), "whole.svg"), t),
        "packed": lambda t: bench_splats.bench_packed(here, binary, shared, out, only, t),
        "shapes": lambda t: bench_splats.bench_shapes(here, binary, out, t),
    }
    others = {
        "key": lambda: bench_key(results, examples, shared),
        "features": lambda: bench_features(results, examples),
        "ablation": lambda: printed(results, ["ablation"], examples, "ablation", [lego, "--budget", "60s"],
                                    env=dict(os.environ, RAYON_NUM_THREADS="1")),
        "step": lambda: printed(results, ["step"], examples, "step_cost",
                                [os.path.join(shared, "data/fox_undistorted_640"), "--warm-up", "300", "--steps", "60"]),
        "growth": lambda: printed(results, ["growth_gaussians", "growth_pixels", "growth_views"], examples, "growth", []),
    }
    for name in args.tables:
        print(f"\n## {name}", flush=True)
        if name in run:
            run[name](results.table(name))
        else:
            others[name]()


if __name__ == "__main__":
    main()
