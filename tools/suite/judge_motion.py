"""Figures of `frames.json` (poses of every frame) and of run.json's motion report, against truth."""

import math
import os

import numpy as np

import judge
import turntable  # on the path since `judge` was imported


def every_frame(folder, truth_folder, fps):
    """Errors of the attitude in all frames of a video, worlds aligned, and errors over deviations
    relative to the frame that is known best."""
    frames = judge.read_json(os.path.join(folder, "frames.json")).get("frames", [])
    truth = judge.read_model(truth_folder)
    names = sorted(truth)
    pairs = [(f, truth[names[k]][0]) for f in frames if (k := round(f["time_s"] * fps)) < len(names)]
    if len(pairs) < 3:
        return {}
    found, true = np.array([turntable.rotation(f["rotation"]) for f, _ in pairs]), np.array([R for _, R in pairs])
    deviations = np.array([f["rotation_deviation_deg"] for f, _ in pairs], dtype=float)
    errors = judge.aligned_errors(found, true)
    record = {"frames": len(pairs), "frames_total": len(names), "frames_median_deg": float(np.median(errors)), "frames_max_deg": float(errors.max())}
    sizes = np.linalg.norm(deviations, axis=1)
    held = int(np.nanargmin(sizes))
    ratios = [np.linalg.norm(judge.rotation_vector_deg((R @ found[held].T) @ (T @ true[held].T).T)) / s
              for R, T, s in zip(found, true, sizes) if s > 0]
    return record | ({"frames_error_over_deviation": float(np.median(ratios))} if ratios else {})


def report(run, motion):
    """The motion report's numbers against the capture's motion: rate, axis, inertia ratios."""
    said = (run.get("poses") or {}).get("motion") or {}
    if not said or motion["type"] not in ("steady turn", "tumble"):
        return {}
    rate = said.get("rate_deg_s") or {}
    record = {}
    if rate and "rate_deg_s" in motion:
        record["rate_error_percent"] = 100 * abs(abs(rate["value"]) / abs(motion["rate_deg_s"]) - 1)
    true_axis = motion.get("momentum_camera") or motion.get("axis_camera")
    if true_axis and said.get("axis_camera"):
        cosine = abs(np.dot(said["axis_camera"], true_axis)) / np.linalg.norm(true_axis)
        record["axis_error_deg"] = math.degrees(math.acos(min(1.0, cosine)))
        record["axis_deviation_deg"] = said.get("axis_camera_deviation_deg")
    ratios = (said.get("tumble") or {}).get("inertia_ratios")
    if ratios and motion["type"] == "tumble":
        true = sorted(motion["inertia"])
        record["inertia_error_percent"] = 100 * max(abs(r["value"] / (t / true[2]) - 1) for r, t in zip(ratios, true))
    return record
