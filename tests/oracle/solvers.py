#!/usr/bin/env python3
"""Solutions of OpenCV's (and, where installed, kornia's) solvers for random minimal problems.

Writes tests/fixtures/solvers/opencv.json, which the unit tests of `sfm::solvers` compare with.
Needs numpy and opencv-python-headless; with kornia and torch present, kornia's eight- and
five-point solvers are checked against the same data and must agree with OpenCV's.
"""

import json
import pathlib

import cv2
import numpy as np

CASES = 12


def scene(rng, n):
    """Points, normalised coordinates in two cameras, and the relative pose."""
    axis = rng.normal(size=3)
    rotation = cv2.Rodrigues(axis / np.linalg.norm(axis) * rng.uniform(0.1, 0.6))[0]
    centre = np.array([0.0, 0.0, 5.0])
    translation = centre - rotation @ centre + rng.uniform(-0.4, 0.4, 3)
    points = centre + rng.uniform(-1.5, 1.5, (n, 3))
    moved = points @ rotation.T + translation
    return points, points[:, :2] / points[:, 2:], moved[:, :2] / moved[:, 2:], rotation, translation


def rows(stack, width=3):
    """3 x 3 matrices stacked by OpenCV, each as nine numbers, row by row."""
    return [] if stack is None else [m.ravel().tolist() for m in np.asarray(stack).reshape(-1, 3, width)]


def p3p(rng):
    points, _, b, _, _ = scene(rng, 3)
    _, rotations, translations = cv2.solveP3P(points, b, np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
    poses = [
        {"rotation": cv2.Rodrigues(r)[0].ravel().tolist(), "translation": t.ravel().tolist()}
        for r, t in zip(rotations, translations)
    ]
    return {"points": points.tolist(), "pixels": b.tolist(), "poses": poses}


def essential(rng):
    _, a, b, _, _ = scene(rng, 5)
    stack, _ = cv2.findEssentialMat(a, b, np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=1e-3)
    check_kornia_essential(a, b, rows(stack))
    return {"a": a.tolist(), "b": b.tolist(), "solutions": rows(stack)}


def fundamental7(rng):
    _, a, b, _, _ = scene(rng, 7)
    stack, _ = cv2.findFundamentalMat(a * 100, b * 100, cv2.FM_7POINT)
    return {"a": (a * 100).tolist(), "b": (b * 100).tolist(), "solutions": rows(stack)}


def fundamental8(rng):
    _, a, b, _, _ = scene(rng, 30)
    a, b = a * 700 + rng.normal(size=a.shape) * 0.5, b * 700 + rng.normal(size=b.shape) * 0.5
    f, _ = cv2.findFundamentalMat(a, b, cv2.FM_8POINT)
    sampson = [
        cv2.sampsonDistance(np.array([*p, 1.0]).reshape(3, 1), np.array([*q, 1.0]).reshape(3, 1), f)
        for p, q in zip(a, b)
    ]
    check_kornia(a, b, f)
    return {"a": a.tolist(), "b": b.tolist(), "solution": f.ravel().tolist(), "sampson": sampson}


def homography(rng):
    a = np.array([[0, 0], [600, 0], [600, 400], [0, 400]], np.float32) + rng.uniform(-80, 80, (4, 2)).astype(np.float32)
    b = a + rng.uniform(-80, 80, (4, 2)).astype(np.float32)
    h = cv2.getPerspectiveTransform(a, b)
    return {"a": a.tolist(), "b": b.tolist(), "solution": h.ravel().tolist()}


def decomposition(rng):
    _, _, _, rotation, translation = scene(rng, 1)
    x, y, z = translation
    e = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    r1, r2, t = cv2.decomposeEssentialMat(e)
    normal = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4), 1.0])
    normal /= np.linalg.norm(normal)
    h = rotation + np.outer(translation, normal) / 5.0
    _, rotations, translations, normals = cv2.decomposeHomographyMat(h, np.eye(3))
    motions = [
        {"rotation": r.ravel().tolist(), "translation": t.ravel().tolist(), "normal": n.ravel().tolist()}
        for r, t, n in zip(rotations, translations, normals)
    ]
    return {
        "essential": e.ravel().tolist(),
        "rotations": [r1.ravel().tolist(), r2.ravel().tolist()],
        "translation": t.ravel().tolist(),
        "homography": h.ravel().tolist(),
        "motions": motions,
    }


def check_kornia(a, b, f):
    """kornia's normalised eight-point algorithm gives the same matrix, where kornia is
    installed."""
    try:
        import kornia.geometry.epipolar as epipolar
        import torch
    except ImportError:
        return
    as_tensor = lambda v: torch.tensor(v[None])
    other = epipolar.find_fundamental(as_tensor(a), as_tensor(b), torch.ones(1, len(a), dtype=torch.float64))[0].numpy()
    unit = lambda m: m / np.linalg.norm(m)
    distance = min(np.linalg.norm(unit(f) - unit(other)), np.linalg.norm(unit(f) + unit(other)))
    assert distance < 1e-6, f"kornia and OpenCV disagree by {distance}"


def check_kornia_essential(a, b, solutions):
    """Each of OpenCV's five-point solutions is among kornia's, where kornia is installed."""
    try:
        from kornia.geometry.epipolar.essential import run_5point
        import torch
    except ImportError:
        return
    as_tensor = lambda v: torch.tensor(v[None])
    found = run_5point(as_tensor(a), as_tensor(b), torch.ones(1, 5, dtype=torch.float64)).numpy().reshape(-1, 3, 3)
    unit = lambda m: m / np.linalg.norm(m)
    found = [unit(m) for m in found if np.isfinite(m).all() and np.linalg.norm(m) > 0]
    for s in solutions:
        s = unit(np.reshape(s, (3, 3)))
        distance = min((min(np.linalg.norm(s - m), np.linalg.norm(s + m)) for m in found), default=np.inf)
        assert distance < 1e-4, f"kornia and OpenCV disagree by {distance}"


def main():
    rng = np.random.default_rng(1)
    makers = [p3p, essential, fundamental7, fundamental8, homography, decomposition]
    fixture = {maker.__name__: [maker(rng) for _ in range(CASES)] for maker in makers}
    fixture["opencv"] = cv2.__version__
    path = pathlib.Path(__file__).resolve().parent.parent / "fixtures" / "solvers" / "opencv.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(fixture) + "\n")
    print(f"{path.relative_to(path.parents[3])}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
