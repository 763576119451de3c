"""Checks the truth of a case against itself: the mesh, through the true poses and lens, must
fall on the true mattes and the true depths.

    python3 check.py CASE FOLDER [--every K]

Silhouettes come from points spread densely over the mesh; prints the worst and the mean
intersection over union, the worst share of pixels that lie more than a pixel outside the other
silhouette, and the median depth difference in pixel footprints, of the best neighbour (the
nearest point in a pixel lies in front of the pixel's mean), away from edges in depth.
Fails where more than 1 % lie outside, or depths differ by more than 1.
"""

import argparse

import numpy as np

import cases
from imagefiles import read_png


def read_mesh(path):
    """Vertices [N, 3] and triangles [M, 3] of a mesh.ply written by render.py."""
    data = open(path, "rb").read()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    counts = {w[1]: int(w[2]) for w in (line.split() for line in data[:end].decode().splitlines()) if w[0] == "element"}
    vertices = np.frombuffer(data, "<f4", 3 * counts["vertex"], end).reshape(-1, 3).astype(float)
    face = np.frombuffer(data, [("n", "u1"), ("v", "<i4", 3)], counts["face"], end + vertices.size * 4)
    return vertices, face["v"]


def spread(vertices, triangles, count, rng):
    """Random points on the surface, by area."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    k = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return a[k] + u * (b - a)[k] + v * (c - a)[k]


def nearest_depth(lens, R, t, points):
    """Depth of the nearest point in each pixel, infinity where there is none."""
    uv, z = cases.project(lens, R, t, points)
    u, v = np.floor(uv).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < lens.width) & (v < lens.height) & (z > 0)
    depth = np.full(lens.width * lens.height, np.inf)
    np.minimum.at(depth, v[inside] * lens.width + u[inside], z[inside])
    return depth.reshape(lens.height, lens.width)


def neighbours(image, outside):
    """The image shifted by up to a pixel in every direction, [9, h, w]."""
    padded = np.pad(image, 1, constant_values=outside)
    h, w = image.shape
    return np.stack([padded[y : y + h, x : x + w] for y in range(3) for x in range(3)])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("case", choices=sorted(cases.CASES))
    parser.add_argument("folder")
    parser.add_argument("--every", type=int, default=1, help="as it was filmed")
    options = parser.parse_args()
    case, folder = cases.CASES[options.case], options.folder
    shot = cases.SHOTS[case.shot]
    filmed = range(0, shot.frames, options.every)
    points = spread(*read_mesh(f"{folder}/mesh.ply"), 3_000_000, np.random.default_rng(1))
    overlaps, strays, differences = [], [], []
    for k in range(0, len(filmed), case.depth_every * max(1, len(filmed) // 108)):
        R, t = cases.camera_from_satellite(shot, filmed[k])
        depth = nearest_depth(shot.lens, R, t, points)
        stem = f"frame_{k:06d}" if case.video_fps else f"still_{k:03d}"
        matte = read_png(f"{folder}/mattes/{stem}.png").astype(float) / 255
        pole = read_png(f"{folder}/pole/{stem}.png").astype(float) / 255
        free = pole < 0.02  # the pole hides the satellite in places and the mesh has no pole
        a, b = np.isfinite(depth) & free, (matte > 0.3) & free
        overlaps.append((a & b).sum() / (a | b).sum())
        near_a, near_b = neighbours(a, False).any(0), neighbours((matte > 0.02), False).any(0)
        strays.append(((a & ~near_b) | (b & ~near_a)).sum() / (a | b).sum())
        stored = read_png(f"{folder}/depth/{stem}.png") / 1e4
        both, footprint = (stored > 0) & np.isfinite(depth), stored / shot.lens.f
        near = neighbours(depth, np.inf)
        # The mean depth of a pixel that shows parts behind each other is that of none of them.
        smooth = both & (near.max(0) < near.min(0) + 8 * footprint)
        judged = smooth if smooth.sum() >= 100 else both
        differences.append(np.median((np.abs(stored - near).min(0) / footprint.clip(1e-9))[judged]))
    print(
        f"{case.name}: {len(overlaps)} frames, silhouette IoU min {min(overlaps):.4f} mean {np.mean(overlaps):.4f}, "
        f"at most {max(strays):.2%} a pixel outside, depth differs by {max(differences):.2f} pixel footprints (worst frame's median)"
    )
    if max(strays) > 0.01 or max(differences) > 1:
        raise SystemExit(f"{case.name}: the truth does not agree with the mesh")


if __name__ == "__main__":
    main()
