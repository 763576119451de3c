#!/usr/bin/env python3
"""Says whether a program gives the same bytes as the program of another commit, on a fixed list of
captures.

    same_bytes.py SAT_RECON SHARED --out FOLDER [--label NAME] [--against NAME] [--only CAPTURE ...]

Runs the list, hashes mattes, poses and cloud (`sparse/0`) and `splat.ply`, and keeps the hashes in
FOLDER/NAME.json (default: the commit of the working tree, with `-dirty` where files differ from
it). With `--against` the hashes are compared with those kept under that name, and what differs is
listed; the exit code is 1 then. Hashes depend on the processor: compare on one machine.
"""
import argparse
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
import time

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..")
# Name, input (below the project, or below SHARED/data where it begins with @), command and flags.
CAPTURES = [
    ("sample", "data/sample/orbit.mp4", "train", ["--quality", "draft"]),
    ("case3", "data/testbed/case3/video.mp4", "train", ["--quality", "draft"]),
    ("temple_ring", "@temple_ring/images", "sfm", []),
    ("fountain_p11", "@fountain_p11/images", "sfm", []),
    ("can_orbit", "@phone_video/can_orbit.mp4", "train", ["--quality", "draft"]),
    ("lego400", "@lego400", "train", ["--iterations", "500"]),
]
# What is compared, below the output folder.
RESULTS = ["images", "masks", "sparse/0", "splat.ply"]


def commit():
    """The commit of the working tree."""
    described = subprocess.run(["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=10"],
                               capture_output=True, text=True, check=True)
    return described.stdout.strip()


def digest(path):
    """One hash over a file, or over names and bytes of all files of a folder; None where there is
    neither."""
    if not os.path.exists(path):
        return None
    total = hashlib.sha256()
    files = [path] if os.path.isfile(path) else sorted(
        os.path.join(folder, name) for folder, _, names in os.walk(path) for name in names)
    for name in files:
        total.update(os.path.relpath(name, path).encode())
        with open(name, "rb") as stream:
            total.update(stream.read())
    return total.hexdigest()


def run(binary, shared, out, capture):
    """Hashes of what one capture gives, with the CPU seconds that it took."""
    name, source, command, flags = capture
    place = os.path.join(shared, "data", source[1:]) if source.startswith("@") else os.path.join(ROOT, source)
    if not os.path.exists(place):
        print(f"{name}: skipped, {place} is missing", file=sys.stderr)
        return None
    folder = os.path.join(out, name)
    shutil.rmtree(folder, ignore_errors=True)
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.time()
    done = subprocess.run([binary, command, place, "-o", folder, "--quiet", *flags], capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if done.returncode not in (0, 3):
        sys.exit(f"{name}: exit code {done.returncode}\n{done.stderr}")
    hashes = {result: digest(os.path.join(folder, result)) for result in RESULTS}
    print(f"{name:14} {cpu:7.1f} CPU s {time.time() - begun:7.1f} s  exit code {done.returncode}", flush=True)
    return {"cpu_s": round(cpu, 1), "exit_code": done.returncode, "sha256": {k: v for k, v in hashes.items() if v}}


def differences(old, new):
    """What is not the same, a line each, of the captures that both have."""
    lines = []
    for name in sorted(set(old) & set(new)):
        before, now = old[name]["sha256"], new[name]["sha256"]
        lines += [f"{name}: {result} differs" for result in sorted(set(before) | set(now)) if before.get(result) != now.get(result)]
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--label", default=None)
    parser.add_argument("--against", default=None)
    parser.add_argument("--only", nargs="+", default=[], choices=[c[0] for c in CAPTURES], metavar="CAPTURE")
    args = parser.parse_args()
    os.makedirs(args.out, exist_ok=True)
    record = os.path.join(args.out, f"{args.label or commit()}.json")
    old = None
    if args.against:
        with open(os.path.join(args.out, f"{args.against}.json")) as stream:
            old = json.load(stream)
    found = {}
    for capture in CAPTURES:
        if args.only and capture[0] not in args.only:
            continue
        hashes = run(args.binary, args.shared, os.path.join(args.out, "runs"), capture)
        if hashes:
            found[capture[0]] = hashes
        with open(record, "w") as stream:
            json.dump(found, stream, indent=1)
    if old is not None:
        lines = differences(old, found)
        print("\n".join(lines) if lines else f"the same bytes as {args.against}: {', '.join(sorted(set(old) & set(found)))}")
        return 1 if lines else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
