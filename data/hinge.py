#!/usr/bin/env python3
"""A scene that moves, as D-NeRF's are given: a box whose lid opens about a hinge, filmed once round
from random places, each photo at its own time.

    hinge.py FOLDER [--views 115] [--size 200] [--still]

Writes FOLDER/images/*.png (RGBA), transforms_{train,val,test}.json with times in [0, 1], as D-NeRF's
program reads them, and transforms.json with all photos, of which every 8th is a test photo (what
sat-recon holds out). Everything is computed: the pictures are exact and the same everywhere.
"""
import argparse
import json
import math
import os
import struct
import zlib

import numpy

# Half sides of base and lid, and where their centres lie, lengths of the scene (the base is 2 wide).
BASE = ((1.0, 0.7, 0.3), (0.0, 0.0, -0.3))
LID = ((1.0, 0.7, 0.08), (0.0, 0.7, 0.08))  # relative to the hinge
HINGE = (0.0, -0.7, 0.0)
KNOB = (0.22, (0.0, 1.1, 0.3))  # radius, and centre relative to the hinge
OPEN = math.radians(110)  # of the lid at time 1
LIGHT = numpy.array([0.4, 0.3, 0.87])
DISTANCE = 5.0  # of the cameras from what they look at
TARGET = numpy.array([0.0, -0.2, 0.3])
ANGLE = 0.6911  # of view, radians; as in NeRF's synthetic scenes
SAMPLES = 3  # a side of a pixel
TEST_EVERY = 8  # as sat-recon holds out


def box(origin, direction, half):
    """Distance to a box around the origin (inf: missed), and the normal there."""
    half = numpy.array(half)
    with numpy.errstate(divide="ignore", invalid="ignore"):
        a, b = (-half - origin) / direction, (half - origin) / direction
    near, far = numpy.fmin(a, b), numpy.fmax(a, b)
    enter = near.max(axis=-1)
    hit = (enter < far.min(axis=-1)) & (enter > 0)
    axis = near.argmax(axis=-1)
    normal = numpy.zeros_like(direction)
    rows = numpy.arange(len(direction))
    normal[rows, axis] = -numpy.sign(direction[rows, axis])
    return numpy.where(hit, enter, numpy.inf), normal


def ball(origin, direction, radius, centre):
    """Distance to a ball (inf: missed), and the normal there."""
    to = origin - numpy.array(centre)
    along = -(to * direction).sum(axis=-1)
    depth = radius**2 - (to**2).sum(axis=-1) + along**2
    t = along - numpy.sqrt(numpy.maximum(depth, 0))
    return numpy.where((depth > 0) & (t > 0), t, numpy.inf), (to + t[:, None] * direction) / radius


def checks(points, scale, colours):
    """A chequered paint in space."""
    odd = numpy.floor(points * scale + 0.013).sum(axis=-1).astype(int) % 2
    return numpy.array(colours)[odd]


def trace(origin, direction, time):
    """Colour and coverage of rays at a time."""
    angle = OPEN * time
    c, s = math.cos(angle), math.sin(angle)
    turn = numpy.array([[1, 0, 0], [0, c, -s], [0, s, c]])  # of the lid about the hinge
    inside, towards = (origin - HINGE) @ turn, direction @ turn
    half, centre = BASE
    found = [(*box(origin - centre, direction, half), origin, direction, numpy.eye(3), 2.5, [(0.8, 0.25, 0.2), (0.9, 0.8, 0.6)])]
    half, centre = LID
    found.append((*box(inside - centre, towards, half), inside, towards, turn, 4.0, [(0.2, 0.45, 0.8), (0.85, 0.9, 0.95)]))
    found.append((*ball(inside, towards, *KNOB), inside, towards, turn, 9.0, [(0.95, 0.7, 0.1), (0.3, 0.3, 0.1)]))
    best = numpy.full(len(direction), numpy.inf)
    rgb = numpy.zeros((len(direction), 3))
    for t, normal, own, along, turned, scale, colours in found:
        nearer = t < best
        points = own[nearer] + t[nearer, None] * along[nearer]
        shade = 0.45 + 0.55 * numpy.maximum((normal[nearer] @ turned.T) @ LIGHT, 0)
        rgb[nearer] = checks(points, scale, colours) * shade[:, None]
        best = numpy.where(nearer, t, best)
    return rgb, numpy.isfinite(best)


def camera(index):
    """Camera to world of a photo: over the upper hemisphere, in no order of time."""
    share = (index * 0.618034) % 1  # neighbours in time stand far apart
    height = 0.05 + 0.85 * ((index * 0.7548777) % 1)
    turn, radius = 2 * math.pi * share, math.sqrt(1 - height**2)
    back = numpy.array([radius * math.cos(turn), radius * math.sin(turn), height])
    right = numpy.cross([0, 0, 1], back)
    right /= numpy.linalg.norm(right)
    matrix = numpy.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, numpy.cross(back, right), back
    matrix[:3, 3] = TARGET + DISTANCE * back
    return matrix


def picture(matrix, time, size):
    """RGBA of a camera at a time, straight alpha."""
    focal = 0.5 * size / math.tan(0.5 * ANGLE)
    at = (numpy.arange(size * SAMPLES) + 0.5) / SAMPLES - 0.5 * size
    x, y = numpy.meshgrid(at, at)
    local = numpy.stack([x, -y, numpy.full_like(x, -focal)], axis=-1).reshape(-1, 3)
    direction = local @ matrix[:3, :3].T
    direction /= numpy.linalg.norm(direction, axis=-1, keepdims=True)
    rgb, hit = trace(numpy.broadcast_to(matrix[:3, 3], direction.shape), direction, time)
    blocks = lambda v: v.reshape(size, SAMPLES, size, SAMPLES, -1).mean(axis=(1, 3))
    alpha, colour = blocks(hit.astype(float)), blocks(rgb)
    colour = numpy.where(alpha > 0, colour / numpy.maximum(alpha, 1e-9), 0)
    return (numpy.concatenate([colour, alpha], axis=-1) * 255 + 0.5).astype(numpy.uint8)


def write_png(path, pixels):
    height, width, _ = pixels.shape
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 6)) + chunk(b"IEND", b""))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--views", type=int, default=115)
    parser.add_argument("--size", type=int, default=200, help="pixels of a side")
    parser.add_argument("--still", action="store_true", help="nothing moves: every photo is of the same time, 0.5")
    args = parser.parse_args()
    os.makedirs(os.path.join(args.folder, "images"), exist_ok=True)
    frames = []
    for index in range(args.views):
        time = 0.5 if args.still else index / max(args.views - 1, 1)
        matrix = camera(index)
        name = f"images/{index:03}"
        write_png(os.path.join(args.folder, name + ".png"), picture(matrix, time, args.size))
        frames.append({"file_path": "./" + name, "time": time, "transform_matrix": matrix.tolist()})
    test = frames[::TEST_EVERY]
    train = [f for i, f in enumerate(frames) if i % TEST_EVERY]
    for kind, chosen in [("_train", train), ("_val", test), ("_test", test), ("", frames)]:
        with open(os.path.join(args.folder, f"transforms{kind}.json"), "w") as file:
            json.dump({"camera_angle_x": ANGLE, "frames": chosen}, file, indent=1)


if __name__ == "__main__":
    main()
