"""Says whether poses are right: rotations of a model against one or several truths.

A model is WRONG when its rotations miss the truth by more than 5 degrees in the median over all
pairs of its images, or more than a tenth of its images are more than 10 degrees off after the best
alignment. Where a capture has several truths (photos of two objects), a model is right if nine
tenths of its images belong to one truth and it is right there.
"""

import json
import os
import sys

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, ".."))
import turntable  # noqa: E402

# Source: a model within them can be repaired by an adjustment, beyond them views contradict it.
WRONG_PAIRS_DEG = 5.0
WRONG_IMAGE_DEG = 10.0
WRONG_IMAGES = 0.1
MEMBERS = 0.9  # share of a model's images that must belong to the truth it is judged by
ALIGNMENTS = 60  # images whose own alignment is tried


def read_json(path):
    """What a file of JSON holds; an empty object where it is missing or none."""
    try:
        with open(path) as file:
            return json.load(file)
    except (OSError, ValueError):
        return {}


def read_model(folder):
    """{name without extension: (R [3, 3], t [3])} of a COLMAP model; empty where there is none."""
    try:
        poses = turntable.read_poses(turntable.model_folder(folder))
    except (SystemExit, OSError):
        return {}
    return {n: (np.array(turntable.rotation(q)), np.array(t)) for n, (q, t) in poses.items()}


def angles_deg(R):
    """Rotation angles of [..., 3, 3], exact for small ones."""
    off = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    return np.degrees(np.arctan2(np.linalg.norm(off, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1))


def rotation_vector_deg(R):
    """Axis times angle in degrees of one rotation matrix."""
    off = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    size = np.linalg.norm(off)
    return off / size * angles_deg(R) if size > 0 else off


def pair_errors(found, true):
    """Errors in degrees of the relative rotations of all pairs; [n, 3, 3] both."""
    i, j = np.triu_indices(len(found), 1)
    relative = [R[j] @ np.swapaxes(R[i], 1, 2) for R in (found, true)]
    return angles_deg(np.swapaxes(relative[0], 1, 2) @ relative[1])


def aligned_errors(found, true):
    """Errors in degrees of each rotation, the worlds aligned for the least median."""
    turns = np.swapaxes(true, 1, 2) @ found
    best = None
    for k in np.unique(np.linspace(0, len(turns) - 1, min(len(turns), ALIGNMENTS)).astype(int)):
        errors = angles_deg(np.swapaxes(turns[k], 0, 1) @ turns)
        if best is None or np.median(errors) < np.median(best[0]):
            best = errors, k
    near = best[0] <= 3 * max(np.median(best[0]), 1e-9)
    U, _, Vt = np.linalg.svd(turns[near].sum(axis=0))
    mean = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return angles_deg(mean.T @ turns)


def auc(found, true, total):
    """Area under the recall curve (percent) at 1, 3, 5 degrees over all pairs of `total` images;
    the error of a pair is the greater of its rotation's and its baseline's direction."""
    centres = [np.array([-R.T @ t for R, t in poses]) for poses in (found, true)]
    rotations = [np.array([R for R, _ in poses]) for poses in (found, true)]
    i, j = np.triu_indices(len(found), 1)
    lines = [np.einsum("nij,nj->ni", R[i], C[j] - C[i]) for R, C in zip(rotations, centres)]
    across = np.linalg.norm(np.cross(*lines), axis=1)
    errors = np.maximum(pair_errors(*rotations), np.degrees(np.arctan2(across, (lines[0] * lines[1]).sum(axis=1))))
    pairs = total * (total - 1) / 2
    return {f"auc_{t}": float(100 * np.maximum(0, 1 - errors / t).sum() / pairs) for t in (1, 3, 5)}


def judge(model, truth, total):
    """Figures of a model's rotations against one truth, and whether it is wrong."""
    names = [n for n in truth if n in model]
    record = {"registered": len(names), "total": total}
    if len(names) < 3:
        return record
    found, true = (np.array([poses[n][0] for n in names]) for poses in (model, truth))
    pairs, images = pair_errors(found, true), aligned_errors(found, true)
    record |= {"pairs_median_deg": float(np.median(pairs)), "rotation_median_deg": float(np.median(images)),
               "rotation_max_deg": float(images.max()), "images_off": float((images > WRONG_IMAGE_DEG).mean())}
    record |= auc([model[n] for n in names], [truth[n] for n in names], max(total, len(names)))
    record["wrong"] = bool(record["pairs_median_deg"] > WRONG_PAIRS_DEG or record["images_off"] > WRONG_IMAGES)
    return record


def judge_any(model, truths, total):
    """The best of several truths; wrong where too many of the model's images are not in it."""
    best = None
    for name, truth in truths.items():
        record = judge(model, truth, total) | {"truth": name}
        strangers = len(model) - record["registered"]
        if strangers > (1 - MEMBERS) * len(model):
            record["wrong"] = True
        key = (record.get("wrong", True), record.get("pairs_median_deg", 1e9))
        if best is None or key < best[0]:
            best = key, record
    return (best[1] if best else {"total": total}) | {"registered": len(model)}


def deviation_ratios(model, truth, stated):
    """Errors over stated deviations: [components], for rotations about the cameras' axes.

    `stated` are run.json's deviations of images; errors are taken relative to the image that is
    held (all its deviations are 0).
    """
    held = [s["name"] for s in stated if not any(s["rotation_deg"])]
    stem = lambda name: os.path.splitext(name)[0]  # noqa: E731
    held = [stem(n) for n in held if stem(n) in model and stem(n) in truth]
    if not held:
        return []
    first = {which: poses[held[0]][0] for which, poses in (("model", model), ("truth", truth))}
    ratios = []
    for image in stated:
        name, sigma = stem(image["name"]), np.array(image["rotation_deg"])
        if name not in model or name not in truth or not (sigma > 0).all():
            continue
        error = (model[name][0] @ first["model"].T) @ (truth[name][0] @ first["truth"].T).T
        ratios += (np.abs(rotation_vector_deg(error)) / sigma).tolist()
    return ratios


def turn_figures(model_folder, truth_folder, names):
    """turntable.py's figures for a turn: errors of the angles, tilt of the axis, closing."""
    try:
        poses = turntable.read_poses(turntable.model_folder(model_folder))
    except (SystemExit, OSError):
        return {}
    truth = turntable.read_poses(truth_folder)
    record, _ = turntable.judge(poses, {n: truth[n] for n in names if n in truth}, len(names))
    keep = ("angle_rms_deg", "angle_max_deg", "axis_tilt_deg", "closing_deg")
    return {k: record[k] for k in keep if k in record}
