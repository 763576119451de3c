#!/usr/bin/env python3
"""Whether the programs that our files are for read them: other people's readers on a finished run.

    readers.py SAT_RECON RUN --out FOLDER --npm FOLDER

pycolmap (PyPI) reads the sets of `export --for`; splat-transform (npm, the converter of SuperSplat)
reads the splat formats; gltf-validator (npm, Khronos) looks for faults in the .glb files, and
Blender, where it is installed, must show the splat's upright. Ends with an error if one of them
complains or reads something else than we wrote. Needs numpy, pillow and pycolmap; FOLDER of --npm
has the node_modules. gsplat's package on PyPI has no reader of data sets: its examples read them
through pycolmap, and pair sorted images with sorted names, so that a folder with one file too many
would shift them; that is checked here. For nerfstudio's own parsers see nerfstudio_reader.py.
"""
import argparse
import json
import os
import shutil
import subprocess
import sys

import numpy as np
from PIL import Image

SETS = {"colmap": None, "3dgs": "RGB", "gsplat": "RGB", "brush": "RGBA"}
SPLATS = ["ply", "compressed.ply", "spz", "sog"]
# Gaussians that a format may move: share of the extent of the scene (positions of 11 bits in parts
# of 256 Gaussians; 24 bits of fixed point; 16 bits of a logarithm).
MOVED = {"ply": 0.0, "compressed.ply": 2e-3, "spz": 1e-3, "sog": 1e-3}


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout


def read_ply(path):
    """The columns of a binary .ply of floats."""
    with open(path, "rb") as file:
        names, count = [], 0
        while (line := file.readline().decode().strip()) != "end_header":
            words = line.split()
            if words[:2] == ["element", "vertex"]:
                count = int(words[2])
            elif words[0] == "property":
                assert words[1] == "float", line
                names.append(words[2])
        rows = np.fromfile(file, "<f4", count * len(names)).reshape(count, len(names))
    return {name: rows[:, i] for i, name in enumerate(names)}


def positions(path):
    columns = read_ply(path)
    return np.stack([columns[axis] for axis in "xyz"], -1)


def read_set(folder, mode, images):
    """A COLMAP model by pycolmap: all images there, as large as their cameras, of this mode."""
    import pycolmap

    model = pycolmap.Reconstruction(os.path.join(folder, "sparse/0"))
    assert model.num_reg_images() == images, (folder, model.num_reg_images(), images)
    for image in model.images.values():
        picture = Image.open(os.path.join(folder, "images", image.name))
        camera = model.cameras[image.camera_id]
        assert picture.size == (camera.width, camera.height), (folder, image.name)
        assert mode is None or picture.mode == mode, (folder, image.name, picture.mode)
        assert mode is None or camera.model.name == "PINHOLE", (folder, camera.model)
    lying = sorted(os.listdir(os.path.join(folder, "images")))
    assert lying == sorted(i.name for i in model.images.values()), (folder, "images without a pose")
    error = model.compute_mean_reprojection_error()
    assert model.num_points3D() > 0 and error < 2.0, (folder, error)
    return f"{images} images, {model.num_points3D()} points, {error:.2f} px by pycolmap {pycolmap.__version__}"


def read_splat(path, kind, reference, transform, out):
    """The Gaussians of a file by splat-transform, against those of our .ply."""
    back = os.path.join(out, f"back_{kind}.ply")
    run(transform, "-w", path, back)
    found, wanted = positions(back), positions(reference)
    assert len(found) == len(wanted), (kind, len(found), len(wanted))
    extent = np.quantile(np.linalg.norm(wanted - np.median(wanted, 0), axis=1), 0.9)
    # Formats may put the Gaussians in another order: quantiles along each axis.
    steps = np.linspace(0.02, 0.98, 49)
    moved = np.abs(np.quantile(found, steps, axis=0) - np.quantile(wanted, steps, axis=0)).max() / extent
    assert moved <= MOVED[kind], (kind, moved)
    return f"{len(found)} Gaussians, moved by {moved:.1e} of the scene's radius at most"


BLENDER = """
import bpy, json, numpy, sys
numpy.bool = bool  # Debian's importer is older than Debian's numpy
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.delete()
bpy.ops.import_scene.gltf(filepath=sys.argv[-1])
points = [o.matrix_world @ v.co for o in bpy.data.objects if o.type == "MESH" for v in o.data.vertices]
print("POINTS" + json.dumps([list(p) for p in points]))
"""


def upright_in_blender(path, reference):
    """Blender has z up: its heights of the vertices against ours, which are -y."""
    said = run("blender", "--background", "--factory-startup", "--python-expr", BLENDER, "--", path)
    found = np.array(json.loads(next(line for line in said.splitlines() if line.startswith("POINTS"))[6:]))
    wanted = positions(reference) @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    steps = np.linspace(0.02, 0.98, 49)
    moved = np.abs(np.quantile(found, steps, axis=0) - np.quantile(wanted, steps, axis=0)).max()
    assert moved <= 2e-2 * np.ptp(wanted, axis=0).max(), (path, moved)
    return f"{len(found)} vertices, upright, off by {moved:.1e} at most by {run('blender', '--version').split(chr(10))[0]}"


VALIDATE = """
const validator = require("gltf-validator");
const fs = require("node:fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then((report) => {
  console.log(JSON.stringify({ version: report.validatorVersion, ...report.issues }));
});
"""


def validate(path, npm):
    env = dict(os.environ, NODE_PATH=os.path.join(npm, "node_modules"))
    said = subprocess.run(["node", "-e", VALIDATE, path], capture_output=True, text=True, env=env, check=True)
    issues = json.loads(said.stdout)
    # It is older than KHR_gaussian_splatting, whose attributes have names that it does not know.
    unknown = "/attributes/KHR_gaussian_splatting:"
    problems = [m for m in issues["messages"] if m["severity"] <= 1 and unknown not in m["pointer"]]
    assert not problems, (path, problems)
    return f"no errors, no warnings by gltf-validator {issues['version']}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sat_recon")
    parser.add_argument("run")
    parser.add_argument("--out", required=True)
    parser.add_argument("--npm", required=True)
    args = parser.parse_args()
    shutil.rmtree(args.out, ignore_errors=True)
    os.makedirs(args.out)
    with open(os.path.join(args.run, "run.json")) as file:
        images = json.load(file)["poses"]["registered"]
    for tool, mode in SETS.items():
        folder = os.path.join(args.out, tool)
        run(args.sat_recon, "export", args.run, "--for", tool, "-o", folder)
        print(f"--for {tool}: {read_set(folder, mode, images)}", flush=True)
    transform = os.path.join(args.npm, "node_modules/.bin/splat-transform")
    reference = os.path.join(args.run, "splat.ply")
    for kind in SPLATS:
        path = os.path.join(args.out, f"splat.{kind}")
        run(args.sat_recon, "export", args.run, "-o", path)
        print(f".{kind}: {read_splat(path, kind, reference, transform, args.out)}", flush=True)
    for name, flags in [("splat.glb", []), ("mesh.glb", ["--mesh"])]:
        path = os.path.join(args.out, name)
        run(args.sat_recon, "export", args.run, *flags, "-o", path)
        print(f"{name}: {validate(path, args.npm)}", flush=True)
    if shutil.which("blender"):
        print(f"splat.glb: {upright_in_blender(os.path.join(args.out, 'splat.glb'), reference)}", flush=True)
    else:
        print("blender is not installed: not asked")


if __name__ == "__main__":
    main()
