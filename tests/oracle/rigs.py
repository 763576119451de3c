#!/usr/bin/env python3
"""A model with rigs and frames as COLMAP 4 writes it: scene/tests/fixtures/rigs/.

Two cameras on one rig, three frames of a made-up scene: cameras, rigs, frames, images and points as
binary files, in text/ as text, and poses.json with what pycolmap says of each image (the pose of
its frame joined with its sensor's). Needs numpy and pycolmap.
"""
import json
import os
import shutil

import pycolmap

OUT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../scene/tests/fixtures/rigs")


def main():
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 2, 3
    options.num_points3D = 20
    model = pycolmap.synthesize_dataset(options)
    shutil.rmtree(OUT, ignore_errors=True)
    os.makedirs(os.path.join(OUT, "text"))
    model.write(OUT)
    model.write_text(os.path.join(OUT, "text"))
    poses = {}
    for image in model.images.values():
        pose = image.cam_from_world()
        x, y, z, w = pose.rotation.quat
        poses[image.name] = {"camera": image.camera_id, "quat_wxyz": [w, x, y, z], "translation": list(pose.translation)}
    with open(os.path.join(OUT, "poses.json"), "w") as file:
        json.dump(poses, file, indent=1)
        file.write("\n")
    print(sorted(os.listdir(OUT)), model.summary())


if __name__ == "__main__":
    main()
