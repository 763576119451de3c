"""Tables of splats: presets, time limits, shapes. Called by bench.py."""
import json
import os
import shutil
import subprocess

import numpy as np
from PIL import Image

SPLATS = [
    # name, input below SHARED/data
    ("lego400", "lego400"),
    ("fox_undistorted_640", "fox_undistorted_640"),
    ("temple_ring", "temple_ring/images"),
    ("can_orbit", "phone_video/can_orbit.mp4"),
    ("oxford_dino", "oxford_dino/images"),
]


def captures(bench, shared):
    """Name and path of what is there: real captures, and the cases of the test bed that are
    rendered."""
    sets = [(name, os.path.join(shared, "data", path)) for name, path in SPLATS]
    sets += [(name, os.path.join(case, "images")) for name, case in bench.ORBITS]
    sets += [(name, os.path.join(case, "video.mp4")) for name, case in bench.TURNS]
    return [(name, path) for name, path in sets if os.path.exists(path)]


def sweep(binary, source, folder, *options, flags=()):
    """The points that `sat-recon bench` measures: frames and poses are made once for all of
    them."""
    subprocess.run([binary, "bench", source, "-o", folder, "-q", *options, *(["--", *flags] if flags else [])], check=True)
    with open(os.path.join(folder, "bench.json")) as file:
        points = json.load(file)["points"]
    for point in points:
        for kind in ("sog", "spz"):
            point[kind + "_kb"] = point[kind + "_bytes"] and point[kind + "_bytes"] / 1000
    return points


# A whole sector of directions is held out as well: every 8th view flatters.
SECTOR_DEG = "60"


def bench_presets(bench, binary, shared, out, only, qualities, table):
    for name, source in captures(bench, shared):
        if not only or name in only:
            wanted, folder, options = set(qualities), os.path.join(out, "splats", name), ["--qualities", ",".join(qualities)]
            of_sector = sweep(binary, source, folder + ", sector", *options, flags=["--test-sector", SECTOR_DEG])
            sectors = {point["setting"]: point["psnr"] for point in of_sector}
            for point in sweep(binary, source, folder, *options):
                if point["setting"] in wanted:
                    table.row(point | dict(input=name, psnr_sector=sectors.get(point["setting"])))


def bench_times(bench, binary, shared, out, only, times, table):
    for name, source in captures(bench, shared):
        if not only or name in only:
            for point in sweep(binary, source, os.path.join(out, "splats", name), "--only-times", "--times", times):
                if point["setting"].endswith(" s"):
                    table.row(point | dict(input=name))


def psnr_of_renders(binary, run, folder):
    """Mean PSNR over the held-out views of a run whose splat.ply may be another's."""
    subprocess.run([binary, "render", run, "-o", folder, "--path", "test", "-q"], check=True)
    photos = os.path.join(run, "eval/photos")

    def picture(*path):
        return np.asarray(Image.open(os.path.join(*path)).convert("RGB"), float)

    pairs = zip(sorted(os.listdir(folder)), sorted(os.listdir(photos)), strict=True)
    errors = [((picture(folder, a) - picture(photos, b)) ** 2).mean() for a, b in pairs]
    shutil.rmtree(folder)
    return float(np.mean([10 * np.log10(255**2 / error) for error in errors]))


def bench_packed(bench, binary, shared, out, only, table):
    """What the packed formats cost: a splat of the preset `draft`, written, read again, rendered."""
    for name, source in captures(bench, shared):
        if only and name not in only:
            continue
        run, renders = os.path.join(out, "packed", name), os.path.join(out, "packed renders")
        subprocess.run([binary, "eval", source, "-o", run, "-q", "--quality", "draft"], check=True)
        with open(os.path.join(run, "run.json")) as file:
            count = json.load(file)["splat"]["gaussians"]
        splat, whole, best = os.path.join(run, "splat.ply"), os.path.join(out, "whole.ply"), None
        shutil.copy(splat, whole)
        for kind in ("ply", "compressed.ply", "spz", "sog"):
            packed = os.path.join(out, "packed." + kind)
            subprocess.run([binary, "export", whole, "-o", packed, "-q"], check=True)
            os.remove(splat)
            subprocess.run([binary, "export", packed, "-o", splat, "-q"], check=True)
            psnr, size = psnr_of_renders(binary, run, renders), os.path.getsize(packed)
            best = psnr if best is None else best
            table.row(dict(input=name, gaussians=count, format=kind, kb=size / 1000, each=size / count, psnr=psnr, lost=best - psnr))
        shutil.copy(whole, splat)


def bench_shapes(bench, binary, out, table):
    """Clouds, splat and fused mesh of case 3 against the true mesh, aligned by the true camera
    centres."""
    case, folder = os.path.join(bench.TESTBED, "case3"), os.path.join(out, "shapes")
    subprocess.run([binary, "eval", os.path.join(case, "video.mp4"), "-o", folder, "-q", "--quality", "draft", "--mesh",
                    os.path.join(case, "mesh.ply"), "--mesh-truth", os.path.join(case, "sparse")], check=True)
    with open(os.path.join(folder, "run.json")) as file:
        geometry = json.load(file)["evaluation"]["geometry"]
    for name, key in (("sparse cloud", "cloud"), ("splat, depths at half transmittance", "surface"),
                      ("dense cloud", "dense"), ("fused mesh", "fused")):
        if geometry.get(key):
            table.row(geometry[key] | dict(surface=name))
