#!/usr/bin/env python3
"""Runs sat-recon on the real captures and prints the tables of docs/benchmarks.md.

    bench.py SAT_RECON SHARED --out FOLDER [--only NAME ...] [--colmap NAME ...]

Poses are judged by `sat-recon compare --truth`, which computes what COLMAP's benchmark papers use: the area under
the recall curve over all image pairs. COLMAP 3.8 runs on the same images in the same call where it is installed.
Costs are CPU seconds (user and system, subprocesses included) and peak resident memory.
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
import turntable

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
# Harder copies of temple_ring, made by SHARED/tools/degrade.py (which needs numpy, pillow and scipy).
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
SPLATS = [
    ("lego400", "lego400", []),
    ("fox_undistorted_640", "fox_undistorted_640", []),
    ("temple_ring", "temple_ring/images", []),
    ("can_orbit", "phone_video/can_orbit.mp4", []),
    ("yaw, 10 % light (case 3)", os.path.join(TESTBED, "case3/video.mp4"), []),
]

TABLES = ["poses", "variants", "dino", "orbits", "turns", "quality", "rings", "key", "splats"]


def measured(command, **options):
    """Runs a command; returns exit code, wall seconds, CPU seconds and peak MiB of its processes."""
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
    return run_json([binary, "compare", model, "--truth", truth, "--json"])[0]


def pose_row(name, tool, record, cpu, wall, peak):
    auc = "–"
    angles = centres = "–"
    if record.get("auc"):
        auc = " / ".join(f"{record['auc'][t]:.1f}" for t in ("1", "3", "5", "10"))
        if record.get("rotation_median_deg") is not None:  # a model of two images has none
            angles = f"{record['rotation_median_deg']:.3f}°"
        if record.get("centre_median_pct") is not None:
            centres = f"{record['centre_median_pct']:.3f} / {record['centre_max_pct']:.3f}"
    print(f"| {name} | {tool} | {record['registered']} of {record['total']} | {auc} | {angles} | {centres} "
          f"| {cpu:.1f} | {wall:.1f} | {peak:.0f} |", flush=True)


def bench_poses(binary, shared, out, only, colmap, sets=POSES):
    print("\n## Poses\n\n| input | tool | registered | AUC@1 / 3 / 5 / 10 | rotation median | centre median / max, % "
          "| CPU s | wall s | peak MiB |\n|---|---|---|---|---|---|---|---|---|")
    for name, source, truth, flags in sets:
        if only and name not in only:
            continue
        folder = os.path.join(out, "poses", name)
        shutil.rmtree(folder, ignore_errors=True)
        source = os.path.join(shared, "data", source)
        truth = truth and os.path.join(shared, "data", truth)
        code, wall, cpu, peak = measured([binary, "sfm", source, "-o", folder, "-q", "--ignore-poses", *flags])
        with open(os.path.join(folder, "run.json")) as file:
            run = json.load(file)
        record = dict(registered=run["poses"]["registered"], total=run["poses"]["total"])
        if truth and code in (0, 3):
            record |= pose_errors(binary, folder, truth)
        pose_row(name, "sat-recon", record, cpu, wall, peak)
        if name in colmap and truth and shutil.which("colmap"):
            bench_colmap(binary, name, os.path.join(folder, "images"), truth, os.path.join(out, "colmap", name))


def bench_variants(binary, shared, out, only):
    print("\n## temple_ring, made harder\n\n| input | tool | registered | AUC@1 / 3 / 5 / 10 | rotation median | centre median / max, % "
          "| CPU s | wall s | peak MiB |\n|---|---|---|---|---|---|---|---|---|")
    truth = os.path.join(shared, "data/temple_ring/cameras_par.txt")
    for i, (name, options) in enumerate(VARIANTS):
        if only and name not in only:
            continue
        images, folder = (os.path.join(out, part, str(i)) for part in ("inputs", "variants"))
        for path in (images, folder):
            shutil.rmtree(path, ignore_errors=True)
        subprocess.run([sys.executable, os.path.join(shared, "tools/degrade.py"), os.path.join(shared, "data/temple_ring/images"),
                        images, *options.split()], check=True, stdout=subprocess.DEVNULL)
        code, wall, cpu, peak = measured([binary, "sfm", images, "-o", folder, "-q"])
        with open(os.path.join(folder, "run.json")) as file:
            poses = json.load(file)["poses"]
        record = dict(registered=poses["registered"], total=poses["total"])
        if code in (0, 3):
            record |= pose_errors(binary, folder, truth)
        pose_row(name, "sat-recon", record, cpu, wall, peak)


def run_colmap(images, folder, masks=None, database=None):
    """Debian's COLMAP 3.8 with its defaults, one camera, on the CPU; its mapper alone where a database is given:
    (folder of models, CPU s, wall s, peak MiB)."""
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


def bench_colmap(binary, name, images, truth, folder, masks=None, database=None):
    """A row of COLMAP 3.8; the folder of its largest model."""
    sparse, cpu, wall, peak = run_colmap(images, folder, masks, database)
    tool = "COLMAP 3.8" + (" on our database" if database else ", inside the masks" if masks else "")
    models = [os.path.join(sparse, m) for m in sorted(os.listdir(sparse))]
    records = [pose_errors(binary, m, truth) | {"model": m} for m in models]
    best = max(records, key=lambda r: r["registered"], default=dict(registered=0)) | {"total": len(os.listdir(images))}
    pose_row(name, tool, best, cpu, wall, peak)
    return best.get("model")


def calibrated(binary, out, kind):
    """Flags that give the camera as photos taken with it by hand calibrate it; none where they are not rendered."""
    images = os.path.join(RENDERED, f"calibration_{kind}", "images")
    folder = os.path.join(out, f"calibration_{kind}")
    if not os.path.isdir(images):
        return []
    shutil.rmtree(folder, ignore_errors=True)
    subprocess.run([binary, "sfm", images, "-o", folder, "-q"], check=True)
    return ["--camera-from", folder]


def turn_row(name, tool, model, truth, total, cpu):
    """One line of the table of turns; `model`: a folder, or None where there is none."""
    try:
        poses = turntable.read_poses(turntable.model_folder(model))
    except (SystemExit, OSError):
        poses = {}
    record, _ = turntable.judge(poses, {n: truth[n] for n in total}, len(total))
    if "angle_rms_deg" not in record:
        print(f"| {name} | {tool} | {record['registered']} of {record['total']} | – | – | – | – | {cpu:.1f} |", flush=True)
        return
    print(f"| {name} | {tool} | {record['registered']} of {record['total']} | {record['angle_rms_deg']:.4f}° / {record['angle_max_deg']:.4f}° "
          f"| {record['axis_tilt_deg']:.3f}° | {record['centre_median_pct']:.3f} / {record['centre_max_pct']:.3f} "
          f"| {record['closing_deg']:+.4f}° | {cpu:.1f} |", flush=True)


def bench_turns(binary, shared, out, only, tools):
    print("\n## Turns about one axis\n\n| input | tool | registered | angles RMS / max | tilt of the axis "
          "| centre median / max, % of the radius | closing error | CPU s |\n|---|---|---|---|---|---|---|---|")
    for name, case in TURNS:
        if (only and name not in only) or not os.path.isfile(os.path.join(case, "video.mp4")):
            continue
        truth = turntable.read_poses(os.path.join(case, "sparse"))
        video, folder = os.path.join(case, "video.mp4"), os.path.join(out, "turns", os.path.basename(case))
        shutil.rmtree(folder, ignore_errors=True)
        known = ["--camera-model", "RADIAL", "--intrinsics", true_intrinsics(case)]
        by_photos = calibrated(binary, out, "video")
        for tool, flags in (("sat-recon", []), ("sat-recon, intrinsics known", known), ("sat-recon, camera from 32 photos", by_photos)):
            if tool != "sat-recon" and not flags:
                continue
            _, _, cpu, _ = measured([binary, "sfm", video, "-o", os.path.join(folder, tool), "-q", *flags])
            frames = [os.path.splitext(f)[0] for f in sorted(os.listdir(os.path.join(folder, tool, "images")))]
            turn_row(name, tool, os.path.join(folder, tool), truth, frames, cpu)
        subprocess.run([binary, "frames", video, "-o", os.path.join(folder, "raw"), "-q", "--key", "off"], check=True)
        for kind, images in (("raw", os.path.join(folder, "raw/images")), ("mattes", os.path.join(folder, "sat-recon/images"))):
            for tool, run in tools:
                models, cpu = run(images, os.path.join(folder, f"{tool} {kind}"))
                turn_row(name, f"{tool}, {kind}", models, truth, frames, cpu)
    bench_steps(binary, shared, out, only)


def bench_orbits(binary, out, only, colmap):
    """Stills of an orbit, nothing known and with the camera calibrated; COLMAP 3.8 beside."""
    print("\n## An orbit in a dark room\n\n| input | tool | registered | AUC@1 / 3 / 5 / 10 | rotation median | centre median / max, % "
          "| CPU s | wall s | peak MiB |\n|---|---|---|---|---|---|---|---|---|")
    for name, case in ORBITS:
        if only and name not in only:
            continue
        if not os.path.isdir(case):
            print(f"| {name} | not measured: make testbed |")
            continue
        images, truth = os.path.join(case, "images"), os.path.join(case, "sparse")
        known = ["--camera-model", "RADIAL", "--intrinsics", true_intrinsics(case)]
        by_photos = calibrated(binary, out, "stills")
        for what, flags in (("", []), (", intrinsics known", known), (", camera from 32 photos", by_photos)):
            if what and not flags:
                continue
            folder = os.path.join(out, "orbits", name + what)
            shutil.rmtree(folder, ignore_errors=True)
            code, wall, cpu, peak = measured([binary, "sfm", images, "-o", folder, "-q", *flags])
            with open(os.path.join(folder, "run.json")) as file:
                poses = json.load(file)["poses"]
            record = dict(registered=poses["registered"], total=poses["total"])
            if code in (0, 3):
                record |= pose_errors(binary, folder, truth)
            pose_row(name + what, "sat-recon", record, cpu, wall, peak)
        if colmap and shutil.which("colmap"):
            bench_colmap(binary, name, images, truth, os.path.join(out, "colmap", name))


def true_intrinsics(case):
    with open(os.path.join(case, "sparse/cameras.txt")) as file:
        line = [line for line in file if not line.startswith("#")][0]
    return ",".join(line.split()[4:])


def bench_steps(binary, shared, out, only):
    """oxford_dino, whose steps are 10 degrees: in its order, and with names that shuffle it."""
    images = os.path.join(shared, "data/oxford_dino/images")
    print("\n| input | registered | motion | steps | standard deviation | CPU s |\n|---|---|---|---|---|---|")
    names = sorted(os.listdir(images))
    order = random.Random(7).sample(range(len(names)), len(names))
    for name, mix in (("oxford_dino", False), ("oxford_dino, shuffled", True)):
        if only and name not in only:
            continue
        folder = os.path.join(out, "turns", name)
        shutil.rmtree(folder, ignore_errors=True)
        source = images
        if mix:
            source = os.path.join(folder, "photos")
            os.makedirs(source)
            for k, i in enumerate(order):
                shutil.copy(os.path.join(images, names[i]), os.path.join(source, f"{k:03d}-{names[i]}"))
        code, _, cpu, _ = measured([binary, "sfm", source, "-o", os.path.join(folder, "out"), "-q"])
        with open(os.path.join(folder, "out/run.json")) as file:
            poses = json.load(file)["poses"]
        motion = next((d[1] for d in poses["decisions"] if d[0] == "motion"), "–")
        if code not in (0, 3):
            print(f"| {name} | 0 of {len(names)} | {motion} | – | – | {cpu:.1f} |", flush=True)
            continue
        record = turntable.steps(turntable.read_poses(turntable.model_folder(os.path.join(folder, "out"))), mix)
        print(f"| {name} | {record['registered']} of {len(names)} | {motion} | {record['step_mean_deg']:.4f}° "
              f"| {record['step_sd_deg']:.4f}° | {cpu:.1f} |", flush=True)


def bench_splats(binary, shared, out, only, qualities):
    print("\n## Splats (every 8th view held out)\n\n| input | quality | gaussians | PSNR | SSIM | worst view | train CPU s "
          "| train wall s | peak MiB |\n|---|---|---|---|---|---|---|---|---|")
    for name, source, flags in SPLATS:
        if only and name not in only:
            continue
        for quality in qualities:
            folder = os.path.join(out, "splats", name + "-" + quality)
            shutil.rmtree(folder, ignore_errors=True)
            source_path = os.path.join(shared, "data", source)
            code, *_ = measured([binary, source_path, "-o", folder, "-q", "--quality", quality, *flags])
            if code not in (0, 3):
                print(f"| {name} | {quality} | failed with exit code {code} |")
                continue
            with open(os.path.join(folder, "run.json")) as file:
                run = json.load(file)
            cost = dict(run["costs"])["train"]
            worst = min(v["metrics"]["psnr"] for v in run["evaluation"]["views"])
            mean = run["evaluation"]["mean"]
            print(f"| {name} | {quality} | {run['splat']['gaussians']} | {mean['psnr']:.2f} | {mean['ssim']:.4f} | {worst:.2f} "
                  f"| {cost['cpu_s']:.0f} | {cost['wall_s']:.0f} | {cost['peak_mib']:.0f} |", flush=True)


def bench_key(examples, shared):
    """Mattes against their truth, beside the plain rule and ffmpeg's chromakey: the example key_table of preprocess."""
    print("\n## Chroma key\n", flush=True)
    table = os.path.join(examples, "key_table")
    if not os.path.exists(table):
        print("not measured: cargo build --release --locked --workspace --example key_table")
        return
    rendered = os.path.join(TESTBED, "../../build/testbed")  # by `make testbed`
    cases = [os.path.join(TESTBED, "case3")] + [os.path.join(rendered, c) for c in ("case4", "blue/case3", "blue/case4")]
    environment = dict(os.environ, SAT_RECON_SHARED=os.path.abspath(shared))
    subprocess.run([table, *(c for c in cases if os.path.exists(os.path.join(c, "video.mp4")))], check=True, env=environment)
    subprocess.run([table, "--no-head"], check=True, env=environment)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="*", help="names of inputs")
    parser.add_argument("--tables", nargs="*", default=TABLES, choices=TABLES)
    parser.add_argument("--rings", nargs="*", type=int, default=[100, 300, 1000], help="images of the simulated rings")
    parser.add_argument("--examples", help="folder with the examples (default: beside SAT_RECON)")
    parser.add_argument("--plot", help="where the SVG of speed against accuracy goes (default: below --out)")
    parser.add_argument("--colmap", nargs="*", default=["temple_ring"], help="inputs on which COLMAP 3.8 runs too")
    parser.add_argument("--quality", nargs="*", default=["fast", "balanced"])
    args = parser.parse_args()
    if not os.path.isdir(os.path.join(args.shared, "data")):
        sys.exit(f"{args.shared}/data is missing: the benchmarks need the real captures")
    if "poses" in args.tables:
        bench_poses(args.binary, args.shared, args.out, args.only, args.colmap)
    if "variants" in args.tables:
        bench_variants(args.binary, args.shared, args.out, args.only)
    if "orbits" in args.tables:
        bench_orbits(args.binary, args.out, args.only, args.colmap)
    here = sys.modules[__name__]
    if "dino" in args.tables:
        bench_sfm.bench_dino(here, args.binary, args.shared, args.out)
    if "quality" in args.tables:
        os.makedirs(args.out, exist_ok=True)
        plot = args.plot or os.path.join(args.out, "speed_accuracy.svg")
        bench_sfm.bench_quality(here, args.binary, args.shared, args.out, plot)
    examples = args.examples or os.path.join(os.path.dirname(os.path.abspath(args.binary)), "examples")
    if "rings" in args.tables:
        bench_sfm.bench_growth(here, os.path.join(examples, "ring_growth"), args.rings)
    if "turns" in args.tables:
        colmap = lambda images, folder: run_colmap(images, folder)[:2]
        tools = [("COLMAP 3.8", colmap)] if shutil.which("colmap") else []
        bench_turns(args.binary, args.shared, args.out, args.only, tools)
    if "key" in args.tables:
        bench_key(examples, args.shared)
    if "splats" in args.tables:
        bench_splats(args.binary, args.shared, args.out, args.only, args.quality)


if __name__ == "__main__":
    main()
