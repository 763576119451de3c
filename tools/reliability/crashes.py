#!/usr/bin/env python3
"""Kills the program, fills its disk and fails its reads at every call to the file system.

    crashes.py PROGRAM --out FOLDER [--rows WORD...] [--every N] [--results FILE [--go-on]]

Inputs are short and small copies of data/sample/orbit.mp4 and of the satellite that yaws before a
green screen (data/testbed/case3). Calls are seen, and made to fail, by the tracer in tests/faults.
After each a run without faults must end with the same bytes as an undisturbed one; a run with a
fault must end by itself, with exit code 1 and an error, or with its result; the same run over a
finished one must not do a stage again for a read that failed. A disk that is full
from a call on which needs no space is full at the next which does: these are tried. A folder that is
left as an earlier call left it (but for times) is not gone on with a second time. Calls are tried
in an order that spreads over the run, so that a part of them says something of all. --rows takes
the rows whose names hold one of the words, --every every N-th call of them. Results are kept after
every 10 calls; --go-on leaves out calls that FILE has. Exits with 1 where one failed.
"""
import argparse
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys

import harness

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
# As little work as still has all stages; one thread, so that calls come in one order.
TINY = ["--threads", "1", "--frames", "6", "--max-size", "240", "--iterations", "8", "--max-gaussians", "1000",
        "--checkpoint-every", "3", "--max-features", "150", "--skip",
        "blurred-features,guided-matching,aliasing,second-attempt,circle-completion,densify,subpixel,plane-tracks"]
OTHER = ["--max-size", "112", "--iterations", "5"]
# Name: video, filter, frames of the copy.
INPUTS = {"sample": ("data/sample/orbit.mp4", "select=not(mod(n\\,4)),scale=128:-2", 6),
          "yaw": ("data/testbed/case3/video.mp4", "select=not(mod(n\\,4)),crop=360:360,scale=128:-2", 6)}
KEEP_EVERY = 10  # calls after which what was found is kept
STRIDE = 16  # calls between those that are tried first; a power of two
# Name, input, what is done, what the tracer counts, flags of the disturbed run where it runs over a
# finished one (`None`: into an empty folder), whether the calls are those that touch the input.
ROWS = [("kill, sample", "sample", "kill", "count", None, False),
        ("kill, yaw", "yaw", "kill", "count", None, False),
        ("kill of a run with other flags over a finished one, sample", "sample", "kill", "count", OTHER, False),
        ("disk full from a call on, sample", "sample", "full", "count", None, False),
        ("disk full from a call on, yaw", "yaw", "full", "count", None, False),
        ("disk full in a run with other flags over a finished one, sample", "sample", "full", "count", OTHER, False),
        ("EIO at a read of the output folder, sample", "sample", "read", "count-reads", None, False),
        ("EIO at a read of the output folder, yaw", "yaw", "read", "count-reads", None, False),
        ("EIO at a read of the video, sample", "sample", "read", "count-reads", None, True),
        ("EIO at a read of the video, yaw", "yaw", "read", "count-reads", None, True),
        ("EIO at a read of the output folder, over a finished run, sample", "sample", "read", "count-reads", [], False)]
# Files that hold times: only that they are there is compared.
VARY = re.compile(r"^\.stages/|run\.json$|report\.html$|eval/metrics\.json$")
TIMED = re.compile(r"(run\.json|report\.html|eval/metrics\.json)$")


def contents(folder):
    """Every file below a folder, by its path in it."""
    found = {}
    for base, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(base, name)
            key = os.path.relpath(path, folder)
            with open(path, "rb") as file:
                found[key] = b"" if VARY.search(key) else file.read()
    return found


def difference(found, wanted):
    """What differs between two folders, in words; empty where nothing does."""
    names = sorted(set(found) ^ set(wanted))
    changed = sorted(n for n in set(found) & set(wanted) if found[n] != wanted[n])
    return "; ".join([f"only in one: {n}" for n in names[:3]] + [f"differs: {n}" for n in changed[:3]])


def timeless(path, folder):
    """A stage's record without times, and with whether each file is as old as the record says."""
    try:
        with open(path) as file:
            record = json.load(file)
    except ValueError:
        return "damaged"
    record.pop("cost", None)
    for output in record.get("outputs", []):
        there = os.path.join(folder, output["path"])
        output["modified_ns"] = os.path.exists(there) and os.stat(there).st_mtime_ns == output["modified_ns"]
        if TIMED.search(output["path"]):
            output["bytes"] = output["hash"] = ""
    return re.sub(r'"(seconds|\w+_s|\w*fps\w*)": [-+.\deE]+', "", json.dumps(record, sort_keys=True))


def records(folder):
    """When each stage's record was written; every run writes its arguments."""
    stages = os.path.join(folder, ".stages")
    names = [name for name in os.listdir(stages) if name.endswith(".json") and name != "args.json"]
    return {name: os.stat(os.path.join(stages, name)).st_mtime_ns for name in names}


def state(folder):
    """What a folder holds, as one number: where it is the same, a next run does the same."""
    known = hashlib.sha256()
    for base, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(folders) + sorted(names):
            path = os.path.join(base, name)
            key = re.sub(r"sat-recon-\w{6}\.tmp", "tmp", os.path.relpath(path, folder))
            known.update(f"{key}\n{os.stat(path).st_mode}\n".encode())
            if os.path.isdir(path):
                continue
            if re.match(r"\.stages/\w+\.json$", key):
                known.update(timeless(path, folder).encode())
            elif TIMED.search(key):
                known.update(str(os.path.getsize(path) == 0).encode())
            else:
                with open(path, "rb") as file:
                    known.update(file.read())
    return known.hexdigest()


class Campaign:
    """A program, a tracer and the inputs in a folder."""

    def __init__(self, program, out):
        self.program, self.folder = program, harness.fresh(os.path.abspath(out))
        self.fault, self.log = os.path.join(self.folder, "fault"), os.path.join(self.folder, "log")
        subprocess.run(["cc", "-O1", "-o", self.fault, os.path.join(ROOT, "tests/faults/fault.c")], check=True)
        for name, (video, filters, frames) in INPUTS.items():
            os.makedirs(os.path.join(self.folder, name))
            subprocess.run(["ffmpeg", "-v", "error", "-i", os.path.join(ROOT, video), "-vf", filters, "-fps_mode", "passthrough",
                            "-frames:v", str(frames), "-crf", "12", "-an", self.video(name)], check=True)

    def video(self, name):
        return os.path.join(self.folder, name, "video.mp4")

    def arguments(self, name, out, flags=None):
        given = {TINY[i]: TINY[i + 1] for i in range(0, len(TINY), 2)}
        given.update({flags[i]: flags[i + 1] for i in range(0, len(flags or []), 2)})
        return [self.video(name), "-o", out, *[word for pair in given.items() for word in pair]]

    def whole(self, name, out):
        """Runs to the end; what the folder holds then."""
        told = harness.run(self.program, self.arguments(name, out))
        # What so few small frames and so short a training make may be doubtful.
        if told["code"] not in (0, 3):
            return None, f"then exit code {told['code']}: {told['said'][-300:]}"
        return contents(out), ""

    def traced(self, name, out, mode, flags, watched):
        os.makedirs(out, exist_ok=True)
        return harness.run(self.fault, [watched, self.log, *mode, self.program, *self.arguments(name, out, flags)])

    def calls(self):
        with open(self.log) as file:
            return file.read().splitlines()

    def finished(self, name, out, copy):
        """Makes the folder what an undisturbed run leaves, anew or from a copy."""
        if not os.path.exists(copy):
            self.whole(name, harness.fresh(out))
            subprocess.run(["cp", "-a", out, copy], check=True)
        shutil.rmtree(out, ignore_errors=True)
        subprocess.run(["cp", "-a", copy, out], check=True)

    def prepared(self, name, out, flags):
        """The folder as the disturbed run finds it."""
        if flags is None:
            harness.fresh(out)
        else:
            self.finished(name, out, out + ".finished")

    def attempt(self, row, out, watched, call, wanted, known):
        """What is wrong after a fault at a call, `None` where nothing is; `known` are the folders
        that were gone on with, by what happened then."""
        _, name, mode, _, flags, _ = row
        self.prepared(name, out, flags)
        before = records(out) if flags == [] else None
        told = self.traced(name, out, [mode, str(call)], flags, watched)
        calls = self.calls()
        problem = "" if mode == "kill" else fault_problem(told, mode)
        if before is not None and records(out) != before:
            problem = problem or "a finished stage ran again"
        left = state(out)
        if left not in known:
            found, why = self.whole(name, out)
            known[left] = why or difference(found, wanted)
        problem = problem or known[left]
        return {"call": call, "at": calls[-1] if calls else "none", "why": problem} if problem else None

    def row(self, row, args, before):
        """Tries the calls of a row, after those of `before`; keeps and returns the result."""
        what, name, mode, count, flags, is_input = row
        out = harness.fresh(os.path.join(self.folder, "out"))
        watched = os.path.join(self.folder, name) if is_input else out
        wanted, why = self.whole(name, out)
        if wanted is None:
            sys.exit(f"{what}: no undisturbed run: {why}")
        shutil.rmtree(out + ".finished", ignore_errors=True)
        self.prepared(name, out, flags)
        self.traced(name, out, [count], flags, watched)
        calls = [n for n, line in enumerate(self.calls(), 1) if mode != "full" or line.split()[2] == "space"]
        done = before["tried"] if before and before["of"] == len(calls) else 0
        result = {"what": what, "tried": done, "of": len(calls), "failed": before["failed"] if done else 0,
                  "failures": before["failures"] if done else []}
        known = {}
        for call in spread(calls[::args.every])[done:]:
            failure = self.attempt(row, out, watched, call, wanted, known)
            result["tried"] += 1
            if failure:
                result["failed"] += 1
                result["failures"].append(failure)
                print(f"{what}: {failure}", flush=True)
            if args.results and result["tried"] % KEEP_EVERY == 0:
                keep(args.results, result)
        if args.results:
            keep(args.results, result)
        print(f"{what}: {len(known)} different folders were gone on with", flush=True)
        return result


def spread(calls):
    """Every STRIDE-th call, then those in the middle between them, and so on."""
    width = STRIDE.bit_length() - 1
    firsts = [int(format(k, f"0{width}b")[::-1], 2) for k in range(STRIDE)]
    return [call for first in firsts for call in calls[first::STRIDE]]


def fault_problem(told, mode):
    """What is wrong with the end of a run that had a fault; empty where nothing is."""
    if told["code"] in (0, 3):
        return ""
    is_told = told["code"] == 1 and "error: " in told["said"] and (mode != "full" or "No space left" in told["said"])
    return "" if is_told else f"exit code {told['code']}: {told['said'][-300:]}"


def kept(path):
    """The rows of the results, by name."""
    if not path or not os.path.exists(path):
        return {}
    with open(path) as file:
        return {row["what"]: row for row in json.load(file)["rows"]}


def keep(path, row):
    """Puts a row into the results; those of other rows stay, also where two campaigns run."""
    folder = os.open(os.path.dirname(os.path.abspath(path)), os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        rows = kept(path)
        rows[row["what"]] = row
        with open(path + ".new", "w") as file:
            json.dump({"rows": [rows[r[0]] for r in ROWS if r[0] in rows]}, file, indent=1)
            file.write("\n")
        os.replace(path + ".new", path)
    finally:
        os.close(folder)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--out", required=True)
    parser.add_argument("--rows", nargs="+", default=[""])
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--results")
    parser.add_argument("--go-on", action="store_true")
    args = parser.parse_args()
    campaign, failures = Campaign(os.path.abspath(args.program), args.out), 0
    for row in ROWS:
        if not any(word in row[0] for word in args.rows):
            continue
        before = kept(args.results).get(row[0]) if args.go_on and args.every == 1 else None
        result = campaign.row(row, args, before)
        failures += result["failed"]
        print(json.dumps({key: result[key] for key in ("what", "tried", "of", "failed")}), flush=True)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
