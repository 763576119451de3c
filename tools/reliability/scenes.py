#!/usr/bin/env python3
"""Runs the program on degenerate scenes and odd files, and asks each for its right answer.

    scenes.py PROGRAM --out FOLDER [--fast] [--only NAME ...] [--list] [--results FILE]

A scene (photo_scenes.py, file_scenes.py) makes its input and says which exit codes are right and
what must be said. Where it is about the sample's orbit, exit code 0 also needs poses within 2° and
5 % of the extent of the true ones. Nothing may crash, hang for five minutes or say nothing. --fast:
those that take no time. Exits with 1 where an answer was wrong.
"""
import argparse
import json
import os
import random
import shutil
import sys

import numpy as np

import colmap
import file_scenes
import harness
import photo_scenes
import scene

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
ALL = {**photo_scenes.SCENES, **file_scenes.SCENES}


def truth():
    """{frame of the sample: (R, t)}."""
    poses = {}
    with open(os.path.join(ROOT, "data/sample/orbit_truth/images.txt")) as file:
        for words in (line.split() for line in file if not line.startswith("#")):
            if words:
                values = [float(v) for v in words[1:8]]
                poses[int(words[9][6:12])] = colmap.rotation(values[:4]), np.array(values[4:])
    return poses


def is_right(run, frames):
    """Whether the poses of a run are those of the frames of the sample; frames: {stem: number}."""
    true, found = truth(), colmap.read_images(os.path.join(run, "sparse/0")).values()
    known = [(i, true[frames[os.path.splitext(i["name"])[0]]]) for i in found if os.path.splitext(i["name"])[0] in frames]
    if len(known) < 3:
        return True  # a pair has no scale to compare
    pose = [(colmap.rotation(i["q"]), np.array(i["t"])) for i, _ in known]
    centres = np.array([-R.T @ t for R, t in pose]), np.array([-R.T @ t for _, (R, t) in known])
    scale, turn, shift = colmap.aligned(*centres)
    extent = np.linalg.norm(centres[1] - centres[1].mean(0), axis=1).max()
    away = np.linalg.norm(scale * centres[0] @ turn.T + shift - centres[1], axis=1) / extent
    traces = [np.trace(R @ turn.T @ other.T) for (R, _), (_, (other, _)) in zip(pose, known)]
    angles = np.degrees(np.arccos(np.clip((np.array(traces) - 1) / 2, -1, 1)))
    return bool(away.max() < 0.05 and angles.max() < 2)


def judge(program, name, out):
    """One scene: what was asked, what came, and whether that is right."""
    asked = ALL[name]
    folder = harness.fresh(os.path.join(out, name))
    made = scene.Made(folder, random.Random(name), program)
    arguments = asked.make(made)
    run = os.path.join(folder, "out")
    if "-o" not in arguments:
        arguments = [*arguments, "-o", run]
    told = harness.run(program, arguments, **made.more)
    said = told["said"].replace(folder + "/", "")
    wrong = []
    if harness.crashed(told):
        wrong.append("a crash or a hang")
    elif told["code"] not in asked.codes:
        wrong.append(f"exit code {told['code']}")
    if told["code"] == 1 and "error: " not in said:
        wrong.append("says nothing")
    wrong += [f"does not say '{word}'" for word in asked.words if word not in said]
    if told["code"] == 0 and made.frames and not is_right(run, made.frames):
        wrong.append("wrong poses")
    if not wrong:
        shutil.rmtree(folder, ignore_errors=True)
    return {"scene": name, "what": asked.what, "asked": asked.codes, "code": told["code"], "said": line_of(said, told["code"]),
            "wrong": wrong, "seconds": round(told["seconds"], 1)}


def line_of(said, code):
    """The line that says most: the error, the reason, or the verdict."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    marks = {1: ["error: "], 2: ["no model: "], 3: ["red: ", "missing "]}.get(code, ["green: ", "yellow: "])
    return next((line for mark in marks for line in lines if mark in line), lines[-1] if lines else "")


def keep(path, rows):
    """Puts the rows into the results, in the place of earlier ones of these scenes."""
    known = {}
    if os.path.exists(path):
        with open(path) as file:
            known = {row["scene"]: row for row in json.load(file)["scenes"]}
    known.update({row["scene"]: row for row in rows})
    with open(path, "w") as file:
        json.dump({"scenes": [known[name] for name in ALL if name in known]}, file, indent=1, ensure_ascii=False)
        file.write("\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--out", required=True)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--results")
    args = parser.parse_args()
    names = [n for n, s in ALL.items() if (not args.only or n in args.only) and (not args.fast or s.is_fast)]
    if args.list:
        print("\n".join(names))
        return
    program = os.path.abspath(args.program)
    scene.prepare(os.path.join(ROOT, "data"), os.path.abspath(args.out))
    rows = []
    for name in names:
        row = judge(program, name, os.path.abspath(args.out))
        rows.append(row)
        if args.results:
            keep(args.results, [row])
        print(f"{'WRONG ' if row['wrong'] else 'right '} {name}: {row['code']} {row['said']} {row['wrong'] or ''}", flush=True)
    sys.exit(1 if any(row["wrong"] for row in rows) else 0)


if __name__ == "__main__":
    main()
