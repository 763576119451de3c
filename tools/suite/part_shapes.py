"""Shapes of parts at rest against the true mesh: F-score, by part too."""

import json
import struct

import numpy as np
from scipy.spatial import cKDTree

SAMPLES = 40_000  # evenly over a surface
NEAR = 0.01  # of the object's size
TYPES = {5123: "<u2", 5125: "<u4", 5126: "<f4"}


def meshes(path):
    """{name: (points [n, 3], triangles [m, 3])} of a glTF file in which every mesh stands where it
    is drawn: that of parts at rest."""
    with open(path, "rb") as file:
        data = file.read()
    length = struct.unpack("<I", data[12:16])[0]
    head, body = json.loads(data[20:20 + length]), data[28 + length:]

    def numbers(index, columns):
        accessor = head["accessors"][index]
        view = head["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        count = accessor["count"] * columns
        return np.frombuffer(body, TYPES[accessor["componentType"]], count, start).reshape(-1, columns)

    found, parents = {}, {child: n for n in head["nodes"] for child in n.get("children", [])}
    for number, node in enumerate(head["nodes"]):
        if "mesh" in node:
            primitive = head["meshes"][node["mesh"]]["primitives"][0]
            name = node.get("name") or parents[number]["name"]
            found[name] = numbers(primitive["attributes"]["POSITION"], 3), numbers(primitive["indices"], 1).reshape(-1, 3)
    return found


def areas(points, triangles):
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def sampled(points, triangles, count=SAMPLES):
    """Points evenly on a surface."""
    rng, sizes = np.random.default_rng(1), areas(points, triangles)
    chosen = triangles[rng.choice(len(triangles), count, p=sizes / sizes.sum())]
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = (points[chosen[:, k]] for k in range(3))
    return a + u * (b - a) + v * (c - a)


def read_ply(path):
    """(points, triangles) of a mesh as film.py writes it."""
    with open(path, "rb") as file:
        data = file.read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    counts = [int(line.split()[2]) for line in data[:end].decode().splitlines() if line.startswith("element")]
    points = np.frombuffer(data, "<f4", 3 * counts[0], end).reshape(-1, 3)
    faces = np.frombuffer(data, np.dtype([("n", "u1"), ("v", "<i4", 3)]), counts[1], end + points.nbytes)
    return points.astype(float), faces["v"]


def scores(path, truth_mesh, frame):
    """F-score at 1 % of the size (percent) of all parts at rest together, and precision, recall of
    each. True points count for the part that comes nearest to them."""
    R, scale, shift = frame
    found = {name: mesh for name, mesh in meshes(path).items() if len(mesh[1])}
    parts = {name: scale * sampled(*mesh) @ R.T + shift for name, mesh in found.items()}
    truth = sampled(*read_ply(truth_mesh))
    near = NEAR * np.linalg.norm(np.ptp(truth, axis=0))
    tree = cKDTree(truth)
    distances = np.array([cKDTree(points).query(truth)[0] for points in parts.values()])
    nearest = distances.argmin(axis=0)
    hits = {name: tree.query(points)[0] < near for name, points in parts.items()}
    weights = [areas(*mesh).sum() for mesh in found.values()]
    precision = np.average([hits[name].mean() for name in found], weights=weights)
    recall = (distances.min(axis=0) < near).mean()
    by_part = {name: [100 * hits[name].mean(), 100 * (distances[:, nearest == k].min(axis=0) < near).mean()]
               for k, name in enumerate(parts)}
    return {"f_score_pct": 200 * precision * recall / (precision + recall), "precision_recall_pct": by_part}
