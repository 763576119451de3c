#!/usr/bin/env python3
"""How well a truth's own cameras explain the sightings of a model, and which part of the rotations'
error is common.

    truth_residuals.py MODEL PAR        MODEL: COLMAP model; PAR: Middlebury's camera file (name, K, R, t on each line)

The points of the model's tracks are placed anew for either set of cameras (least squares under
Cauchy's loss), so that only cameras are compared: where the truth leaves the larger residuals, a
distance from it is no longer an error of the model alone. The cost is 2 sum log(1 + (e / 2 s)^2), e
in pixels, s the noise given with --noise-px.

Needs numpy and pycolmap. Shares no code with what it judges.
"""
import argparse

import numpy as np
import pycolmap


def cameras_of_model(model):
    """Names, and K, R, t [n x 3 x 3, n x 3 x 3, n x 3] of the images, distortion left out."""
    names, k, r, t = [], [], [], []
    for image in model.images.values():
        pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
        names.append(image.name)
        k.append(model.cameras[image.camera_id].calibration_matrix())
        r.append(pose.rotation.matrix())
        t.append(pose.translation)
    return names, np.array(k), np.array(r), np.array(t)


def cameras_of_truth(path, names, half_pixel):
    """The same of a Middlebury file; its pixel centres are integers, COLMAP's lie half a pixel
    farther."""
    lines = [line.split() for line in open(path, encoding="utf-8").read().splitlines()]
    values = {f[0]: np.array(f[1:22], float) for f in lines if len(f) >= 22}
    rows = np.array([values[name] for name in names])
    k = rows[:, :9].reshape(-1, 3, 3)
    k[:, :2, 2] += half_pixel
    return k, rows[:, 9:18].reshape(-1, 3, 3), rows[:, 18:]


def centres(r, t):
    return -np.einsum("nji,nj->ni", r, t)


def similarity(a, b):
    """Scale, rotation and shift that take a to b (Horn 1987)."""
    ma, mb = a.mean(0), b.mean(0)
    u, s, vt = np.linalg.svd((b - mb).T @ (a - ma))
    d = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ d @ vt
    scale = (s * np.diag(d)).sum() / ((a - ma) ** 2).sum()
    return scale, rotation, mb - scale * rotation @ ma


def residuals(k, r, t, points, image, point, pixel, noise):
    """Lengths of the residuals after 25 steps of reweighted least squares on the points."""
    x = points.copy()
    for _ in range(25):
        local = np.einsum("oij,oj->oi", r[image], x[point]) + t[image]
        h = np.einsum("oij,oj->oi", k[image], local)
        error = h[:, :2] / h[:, 2:] - pixel
        length = np.linalg.norm(error, axis=1)
        weight = 1 / (1 + (length / (2 * noise)) ** 2)
        slope = (k[image][:, :2] - (h[:, :2] / h[:, 2:])[:, :, None] * k[image][:, 2:]) / h[:, 2, None, None]
        jacobian = np.einsum("oij,ojk->oik", slope, r[image])
        normal, right = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3))
        np.add.at(normal, point, weight[:, None, None] * np.einsum("oki,okj->oij", jacobian, jacobian))
        np.add.at(right, point, weight[:, None] * np.einsum("oki,ok->oi", jacobian, error))
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        x -= np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return length


def rotation_vector(m):
    """Of a small rotation, degrees."""
    return np.degrees([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / 2


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("truth")
    parser.add_argument("--noise-px", type=float, default=0.13)
    args = parser.parse_args()
    model = pycolmap.Reconstruction(args.model)
    names, k, r, t = cameras_of_model(model)
    index = {p: i for i, p in enumerate(model.points3D)}
    points = np.array([model.points3D[p].xyz for p in index])
    sightings = [(n, index[p.point3D_id], *p.xy) for n, image in enumerate(model.images.values())
                 for p in image.points2D if p.has_point3D()]
    image, point = (np.array([s[i] for s in sightings]) for i in (0, 1))
    pixel = np.array([s[2:] for s in sightings])

    def show(name, cameras, places):
        e = residuals(*cameras, places, image, point, pixel, args.noise_px)
        cost = 2 * np.log1p((e / (2 * args.noise_px)) ** 2).sum()
        print(f"{name:40s} residuals: median {np.median(e):.3f} px, cost {cost:.0f}")

    show("the model's cameras", (k, r, t), points)
    for half in (0.0, 0.5):
        truth = cameras_of_truth(args.truth, names, half)
        scale, turn, shift = similarity(centres(r, t), centres(*truth[1:]))
        show(f"the truth's, principal point + {half} px", truth, scale * points @ turn.T + shift)
    # What is left of the rotations after the centres are aligned, in the cameras' frames.
    left = np.array([rotation_vector(a @ turn.T @ b.T) for a, b in zip(r, truth[1])])
    own = np.array([image.camera_id for image in model.images.values()])
    print(f"rotations off by {np.median(np.linalg.norm(left, axis=1)):.3f} deg (median)")
    for camera in sorted(set(own)):
        common = left[own == camera].mean(0)
        print(f"camera {camera}: {np.sum(own == camera)} images are off by ({', '.join(f'{c:.3f}' for c in common)}) deg in common")
        left[own == camera] -= common
    print(f"without that {np.median(np.linalg.norm(left, axis=1)):.3f} deg (median)")


if __name__ == "__main__":
    main()
