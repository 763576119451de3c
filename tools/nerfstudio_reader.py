#!/usr/bin/env python3
"""Whether nerfstudio's own parsers read the sets of `export --for`, with our poses, points and split.

    nerfstudio_reader.py SAT_RECON RUN --out FOLDER

Needs nerfstudio from PyPI with torch (`make readers-nerfstudio` installs both).
NerfstudioDataParser reads the set for nerfstudio as `ns-train splatfacto` does, ColmapDataParser
the one for COLMAP. Both turn, centre and scale what they read and say by what; that undone, poses
and points are compared with the model that RUN holds (by nerfstudio's own reader of COLMAP files).
Ends with an error where they differ.
"""
import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from nerfstudio.data.dataparsers.colmap_dataparser import ColmapDataParserConfig
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
from nerfstudio.data.datasets.base_dataset import InputDataset
from nerfstudio.data.utils import colmap_parsing_utils as colmap

# Numbers of four bytes in nerfstudio, about a world of radius 1.
EXACT = 2e-5


def parsed(config, split):
    """What the parser says of a split, with every picture loaded once."""
    outputs = config.setup().get_dataparser_outputs(split=split)
    pictures = InputDataset(outputs)
    for i in range(len(pictures)):
        picture = pictures[i]["image"]
        size = (int(outputs.cameras.height[i]), int(outputs.cameras.width[i]))
        assert tuple(picture.shape[:2]) == size, (outputs.image_filenames[i], picture.shape, size)
    return outputs


def world(outputs):
    """From the parser's world back to that of the file, 4x4 with its scale."""
    forward = np.eye(4)
    forward[:3] = outputs.dataparser_transform.numpy()[:3]
    forward[:3] *= outputs.dataparser_scale
    return np.linalg.inv(forward)


def centres(outputs):
    """Camera centres in the world of the file, by the stem of the image's name."""
    back = world(outputs)
    ends = outputs.cameras.camera_to_worlds[:, :, 3].numpy() @ back[:3, :3].T + back[:3, 3]
    return {Path(name).stem: end for name, end in zip(outputs.image_filenames, ends)}


def axes(outputs):
    """Directions of view in the world of the file, by the stem of the image's name."""
    back = world(outputs)[:3, :3]
    back = back / np.cbrt(np.linalg.det(back))
    ahead = -outputs.cameras.camera_to_worlds[:, :, 2].numpy() @ back.T
    return {Path(name).stem: way for name, way in zip(outputs.image_filenames, ahead)}


class Model:
    """The run's model, in the convention of a set: `turned` of it are rows of that world."""

    def __init__(self, run, turned):
        images = colmap.read_images_binary(os.path.join(run, "sparse/0/images.bin"))
        points = colmap.read_points3D_binary(os.path.join(run, "sparse/0/points3D.bin"))
        rotations = {Path(i.name).stem: colmap.qvec2rotmat(i.qvec) for i in images.values()}
        self.centres = {}
        for image in images.values():
            stem = Path(image.name).stem
            self.centres[stem] = turned @ -(rotations[stem].T @ image.tvec)
        self.axes = {stem: turned @ rotation[2] for stem, rotation in rotations.items()}
        self.points = np.array([p.xyz for p in points.values()]) @ turned.T

    def compare(self, outputs):
        """Largest difference of centres, axes and points from those that were read."""
        worst = 0.0
        for own, read in [(self.centres, centres(outputs)), (self.axes, axes(outputs))]:
            worst = max(worst, max(np.abs(own[stem] - read[stem]).max() for stem in read))
        back = world(outputs)
        read = outputs.metadata["points3D_xyz"].numpy() @ back[:3, :3].T + back[:3, 3]
        assert len(read) == len(self.points), (len(read), len(self.points))
        steps = np.linspace(0.02, 0.98, 49)
        quantiles = np.quantile(read, steps, axis=0) - np.quantile(self.points, steps, axis=0)
        worst = max(worst, np.abs(quantiles).max())
        scale = max(1.0, max(np.abs(c).max() for c in self.centres.values()))
        assert worst <= EXACT * scale, worst
        return worst


def read_set(run, tool, folder, held_out):
    """Both splits by the parser for this set; what was read, in words."""
    data = Path(folder)
    if tool == "nerfstudio":
        config = NerfstudioDataParserConfig(data=data, load_3D_points=True)
        # transforms.json: x, y, z up of our x, z, -y.
        turned = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    else:
        every = max(2, round(len(os.listdir(data / "images")) / len(held_out)))
        config = ColmapDataParserConfig(
            data=data, colmap_path=Path("sparse/0"), eval_interval=every, downscale_factor=1
        )
        turned = np.eye(3)
    model = Model(run, turned)
    train, test = parsed(config, "train"), parsed(config, "val")
    worst = max(model.compare(train), model.compare(test))
    seen, unseen = ({Path(name).stem for name in o.image_filenames} for o in (train, test))
    assert unseen == held_out, (tool, unseen ^ held_out)
    assert not seen & unseen and len(seen | unseen) == len(model.centres), tool
    return (f"{len(seen)} training and {len(unseen)} held-out views, {len(model.points)} points, "
            f"off by {worst:.1e} at most")


def main():
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("sat_recon")
    parser.add_argument("run")
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    shutil.rmtree(args.out, ignore_errors=True)
    with open(os.path.join(args.run, "transforms.json")) as file:
        held_out = {Path(name).stem for name in json.load(file)["test_filenames"]}
    for tool in ["nerfstudio", "colmap"]:
        folder = os.path.join(args.out, tool)
        done = subprocess.run([args.sat_recon, "export", args.run, "--for", tool, "-o", folder])
        if done.returncode != 0:
            sys.exit(f"export --for {tool}: exit code {done.returncode}")
        print(f"--for {tool}: {read_set(args.run, tool, folder, held_out)}", flush=True)


if __name__ == "__main__":
    main()
