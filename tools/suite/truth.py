"""The truth beside a capture: COLMAP text model with exact poses, and the motion in numbers."""

import json
import os
from dataclasses import asdict

import motions


def frame_name(capture, k):
    """What sat-recon calls frame k of a video; a photo's own name."""
    return f"frame_{k:06d}.png" if capture.fps else f"still_{k:03d}.jpg"


def write_model(folder, camera, names, poses):
    """A COLMAP text model without points: one camera line, poses camera_from_body by name."""
    os.makedirs(folder, exist_ok=True)
    with open(f"{folder}/cameras.txt", "w") as file:
        file.write(f"# the true camera\n1 {camera}\n")
    with open(f"{folder}/images.txt", "w") as file:
        file.write("# the true poses, camera from body: id qw qx qy qz tx ty tz camera name\n")
        for k, (name, (R, t)) in enumerate(zip(names, poses)):
            numbers = " ".join(f"{x:.15g}" for x in (*motions.matrix_quaternion(R), *t))
            file.write(f"{k + 1} {numbers} 1 {name}\n\n")
    with open(f"{folder}/points3D.txt", "w") as file:
        file.write("# none\n")


def write(folder, capture, plan, poses, record, facts):
    """`sparse/`, `motion.json` (with the times of the frames) and `capture.json`."""
    lens = plan["lens"]
    camera = f"RADIAL {plan['width']} {plan['height']} {lens['f']} {lens['cx']} {lens['cy']} {lens['k1']} {lens['k2']}"
    write_model(f"{folder}/sparse", camera, [frame_name(capture, k) for k in range(len(poses))], poses)
    if capture.fps:
        record = record | {"fps": capture.fps, "times_s": [k / capture.fps for k in range(len(poses))]}
    with open(f"{folder}/motion.json", "w") as file:
        json.dump(record, file)
    about = asdict(capture) | {"name": capture.name, "half": capture.half, "ground": plan["ground"], "lens": lens,
                               "light": plan["light"], "frames": len(poses)} | facts
    with open(f"{folder}/capture.json", "w") as file:
        json.dump(about, file, indent=1)
