#!/usr/bin/env python3
"""Counts the wrong models and data sets that the program takes for right ones.

    models.py PROGRAM --out FOLDER [--first 0] [--count 2000] [--seed 1] [--results FILE]

Good sets of eight frames of data/sample/orbit.mp4 (a COLMAP model as text and binary, and
transforms.json) are damaged (damage.py), or bytes of their files are, or their photos, and
`sat-recon sfm` is run on each. Accepted nonsense is exit code 0 with an output model that is wrong
by differences() of colmap.py, or whose photos are not those of the model. One set in ten is
changed in a harmless way: these must be taken. Exits with 1 where one was not as it should be; the
sets that were not are kept. --first 500 goes on after the first 500 sets, whose results are in FILE.
"""
import argparse
import collections
import copy
import json
import math
import os
import random
import shutil
import sys

import numpy as np

import colmap
import damage
import harness
import photos

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
FRAMES, SIZE = 8, (240, 180)


def base(program, out):
    """(folder of the frames, model, transforms) of a good set, made by the program itself."""
    images, run = os.path.join(out, "frames"), os.path.join(out, "base")
    harness.frames(os.path.join(ROOT, "data/sample/orbit.mp4"), images, f"scale={SIZE[0]}:{SIZE[1]}", FRAMES)
    told = harness.run(program, ["sfm", images, "-o", run, "--keep-frame"], 600)
    if told["code"] != 0:
        sys.exit(f"no good set: {told['said']}")
    with open(os.path.join(run, "transforms.json")) as file:
        transforms = json.load(file)
    return images, colmap.read(os.path.join(run, "sparse/0")), transforms


def of_transforms(transforms, change, rng):
    """transforms.json with its cameras and poses changed as a model's."""
    model = {"cameras": {}, "images": {}, "points": {}}
    flip = np.diag([1.0, -1, -1, 1])
    t = transforms
    model["cameras"][1] = ["SIMPLE_RADIAL", t["w"], t["h"], [t["fl_x"], t["cx"], t["cy"], t.get("k1", 0.0)]]
    for number, frame in enumerate(t["frames"], 1):
        pose = np.linalg.inv(np.array(frame["transform_matrix"]) @ flip)
        model["images"][number] = {"q": damage.from_matrix(pose[:3, :3]), "t": list(pose[:3, 3]), "camera": 1,
                                   "name": frame["file_path"], "seen": []}
    change(model, rng)
    changed = copy.deepcopy(transforms)
    _, changed["w"], changed["h"], parameters = model["cameras"][1]
    parameters = parameters + [0.0] * 4
    changed["fl_x"] = changed["fl_y"] = parameters[0]
    changed["cx"], changed["cy"], changed["k1"] = parameters[1:4]
    changed["frames"] = []
    for image in model["images"].values():
        length = np.linalg.norm(image["q"])
        pose = np.eye(4)
        with np.errstate(all="ignore"):
            # A quaternion of another length would make a matrix that is no rotation.
            R = colmap.rotation(image["q"]) * length
            pose[:3, :3], pose[:3, 3] = R.T, -R.T @ np.array(image["t"])
            matrix = (pose @ flip).tolist()
        changed["frames"].append({"file_path": image["name"], "transform_matrix": matrix})
    return changed


# What of damage.WRONG and HARMLESS can be said in transforms.json.
FOR_TRANSFORMS = ["quaternion_of_no_rotation", "number_of_a_pose_is_nonsense", "poses_are_equal", "poses_are_exchanged",
                  "poses_are_shifted_by_one", "rotation_is_off", "position_is_off", "pose_is_the_inverse", "quaternion_order_is_another",
                  "axes_are_another_convention", "image_size_is_another", "focal_length_is_another", "principal_point_is_another",
                  "distortion_is_huge", "names_are_repeated", "names_are_exchanged", "names_are_shifted_by_one", "name_leads_elsewhere",
                  "image_is_left_out", "nothing", "world_is_another", "quaternions_have_another_sign_and_few_digits"]


def damaged_bytes(path, rng):
    """Bits, bytes, numbers and pieces of a file."""
    with open(path, "rb") as file:
        data = bytearray(file.read())
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(data))
        kind = rng.randrange(5)
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            data[at : at + 8] = rng.choice([b"\xff" * 8, b"\0" * 8, b"\0\0\0\0\0\0\xf0\x7f"])
        elif kind == 2:
            del data[at:]
            break
        elif kind == 3:
            del data[at : at + rng.randint(1, 64)]
        else:
            data[at:at] = data[at : at + rng.randint(1, 64)]
    with open(path, "wb") as file:
        file.write(data)


class Set:
    """One damaged set in a folder."""

    def __init__(self, good, folder, number, seed):
        self.images, self.model, self.transforms = good
        self.rng = random.Random(f"{seed}/{number}")
        self.folder = harness.fresh(folder)
        self.photos = os.path.join(folder, "images")
        shutil.copytree(self.images, self.photos)
        self.is_harmless, self.photos_are_wrong = number % 10 == 0, False
        self.form = ["text", "binary", "transforms"][number % 3]
        self.what = self.make()

    def make(self):
        kind = "harmless" if self.is_harmless else self.rng.choice(["model"] * 6 + ["bytes"] * 2 + ["photos"] * 2)
        if kind in ("model", "harmless"):
            known = damage.HARMLESS if self.is_harmless else damage.WRONG
            name = self.rng.choice([n for n in known if self.form != "transforms" or n in FOR_TRANSFORMS])
            self.write(known[name])
            return name
        self.write(damage.HARMLESS["nothing"])
        if kind == "photos":
            name = self.rng.choice(sorted(photos.WRONG))
            photos.WRONG[name](self.photos, self.rng)
            self.photos_are_wrong = True
            return name
        files = [os.path.join(self.folder, "transforms.json")]
        if self.form != "transforms":
            sparse = os.path.join(self.folder, "sparse/0")
            files = [os.path.join(sparse, n) for n in sorted(os.listdir(sparse))]
        damaged_bytes(self.rng.choice(files), self.rng)
        return "bytes"

    def write(self, change):
        if self.form == "transforms":
            with open(os.path.join(self.folder, "transforms.json"), "w") as file:
                json.dump(of_transforms(self.transforms, change, self.rng), file)
            return
        model = copy.deepcopy(self.model)
        change(model, self.rng)
        write = colmap.write_text if self.form == "text" else colmap.write_binary
        write(model, os.path.join(self.folder, "sparse/0"))

    def judge(self, program):
        """(class of the outcome, why)."""
        out = os.path.join(self.folder, "out")
        told = harness.run(program, ["sfm", self.folder, "-o", out, "--threads", "1"])
        if harness.crashed(told):
            return "crash", told["said"][-300:]
        if self.is_harmless:
            return ("taken", "") if told["code"] == 0 else ("refused without need", told["said"][-300:])
        if told["code"] != 0:
            if told["code"] == 1 and "error:" not in told["said"]:
                return "refused without a word", told["said"][-300:]
            return {1: "refused", 2: "no model", 3: "doubtful"}[told["code"]], ""
        if self.photos_are_wrong:
            return "accepted nonsense", "the photos are others"
        sizes = {name: SIZE for name in os.listdir(self.images)}
        apart = colmap.differences(colmap.read(os.path.join(out, "sparse/0")), self.model, sizes)
        return ("accepted nonsense", "; ".join(apart[:3])) if apart else ("mended or harmless", "")


def keep(args, table, failures):
    """Writes the results, after those of the sets before the first."""
    if args.first:
        with open(args.results) as file:
            before = json.load(file)
        if (before["sets"], before["seed"]) != (args.first, args.seed):
            sys.exit(f"{args.results} does not hold sets 0 to {args.first} of seed {args.seed}")
        for name, counts in before["by_damage"].items():
            table[name].update(counts)
        failures = before["failures"] + failures
    result = {"sets": args.first + args.count, "seed": args.seed, "by_damage": table, "failures": failures,
              "totals": sum(table.values(), collections.Counter())}
    with open(args.results, "w") as file:
        json.dump(result, file, indent=1, sort_keys=True)
        file.write("\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--out", required=True)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--results")
    args = parser.parse_args()
    program = os.path.abspath(args.program)
    good = base(program, harness.fresh(args.out))
    table, failures = collections.defaultdict(collections.Counter), []
    for number in range(args.first, args.first + args.count):
        case = Set(good, os.path.join(args.out, f"set{number:05}"), number, args.seed)
        outcome, why = case.judge(program)
        table[case.what][outcome] += 1
        if outcome in ("crash", "accepted nonsense", "refused without need", "refused without a word"):
            failures.append({"set": number, "form": case.form, "what": case.what, "outcome": outcome, "why": why})
            print(f"{number} {case.form} {case.what}: {outcome}: {why}", flush=True)
        else:
            shutil.rmtree(case.folder)
    print(json.dumps(dict(sum(table.values(), collections.Counter()))))
    if args.results:
        keep(args, table, failures)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
