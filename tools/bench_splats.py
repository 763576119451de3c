"""Tables of splats: presets, time limits, shapes. Called by bench.py."""
import json
import os
import subprocess

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
        return json.load(file)["points"]


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
