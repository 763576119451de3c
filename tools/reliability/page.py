#!/usr/bin/env python3
"""Writes docs/reliability.md from the results in docs/results.

    page.py RESULTS --out docs/reliability.md [--check]

RESULTS holds fuzz.json (`make fuzz`), models.json, scenes.json, flags.json and resources.json
(`make reliability`), crashes.json (`make crash-test`) and sanitize.json (`make sanitize`). --check writes nothing and fails where the page is another.
"""
import argparse
import collections
import json
import os
import sys

ASKED = 1_000_000_000  # executions of fuzzing over which nothing may fail


def read(folder, name):
    path = os.path.join(folder, name)
    if not os.path.exists(path):
        return None
    with open(path) as file:
        return json.load(file)


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows] + [""]


def cell(text):
    """Text that is shown as it is in a cell."""
    return "".join(c if c.isprintable() else "�" for c in text).replace("|", "\\|").replace("<", "&lt;")


def fuzzing(result):
    sums, runs = result["targets"], result["runs"]
    executions = sum(s["executions"] for s in sums.values())
    failures = sum(s["failures"] for s in sums.values())
    hours = sum(r["seconds"] for r in runs) / 3600
    commits = ", ".join(f"`{c}`" for c in dict.fromkeys(r["commit"] for r in runs))
    aim = f"the aim is {ASKED / 1e9:.0f} billion" + ("" if executions >= ASKED else f", so {100 * executions / ASKED:.2g} % is done")
    notes = collections.Counter()
    for run in runs:
        if run.get("note"):
            notes[run["note"]] += run["failures"]
    rows = [(name, f"{s['executions'] / 1e6:.3f}", f"{s['executions'] / max(s['seconds'], 1e-9) / 1000:.1f}",
             f"{100 * s['accepted'] / max(s['executions'], 1):.0f} %", s["failures"])
            for name, s in sorted(sums.items())]
    return [
        "## Mutated files",
        "`make fuzz` feeds every reader with files of which bits, counts, pieces and numbers were changed. An",
        "execution fails with a panic, after a second a kilobyte, or with more memory than 64 times the file and",
        f"what small files may unpack to. {len(runs)} runs of {hours:.1f} hours in all, at commits {commits}, made",
        f"{executions / 1e6:.1f} million executions with {failures} failures; {aim}.",
        "Files that failed once are kept in `fuzz/regressions` and are tried first.",
        *[f"Of the failures, {n} are {note}." for note, n in notes.items()],
        "",
        *table(["target", "million executions", "thousand a second", "accepted", "failures"], rows),
    ]


def mutated(result):
    totals = result["totals"]
    kinds = sorted({k for counts in result["by_damage"].values() for k in counts})
    rows = [[name.replace("_", " "), *(counts.get(k, 0) for k in kinds)] for name, counts in sorted(result["by_damage"].items())]
    return [
        "## Wrong models and data sets",
        f"`tools/reliability/models.py` damages a good set of eight photos in {result['sets']} ways: poses, cameras,",
        "points, tracks, names, photos or bytes, of COLMAP models (text and binary) and `transforms.json`. Accepted",
        "nonsense is exit code 0 with poses off by 1° or 2 %, a camera off by 2 % of the image, one observation in a",
        "hundred off by 5 %, or photos that are not those of the model. One set in ten is changed in a harmless way and",
        f"must be taken. Accepted nonsense: {totals.get('accepted nonsense', 0)}; crashes: {totals.get('crash', 0)}; "
        f"refused without need: {totals.get('refused without need', 0)}.",
        "",
        *table(["what was done", *kinds], rows),
    ]


def degenerate(result):
    wrong = [row for row in result["scenes"] if row["wrong"]]
    rows = [(row["what"], " or ".join(map(str, row["asked"])), f"{row['code']}{' (wrong)' if row['wrong'] else ''}", cell(row["said"][:160]))
            for row in result["scenes"]]
    return [
        "## Degenerate scenes and odd files",
        f"Of `tools/reliability/scenes.py`, {len(rows)} scenes have been run; {len(wrong)} answers are wrong. Where several",
        "exit codes are right, 0 also needs poses within 2° and 5 % of the true ones.",
        "",
        *table(["scene", "right exit codes", "exit code", "what the program says"], rows),
    ]


def flags(result):
    return [
        "## Numbers of flags",
        f"`tools/reliability/flags.py` gave flags {result['tried']} values such as `nan`, `inf`, -1 and 2^64;",
        f"{len(result['crashes'])} ended in another way than with exit code 1.",
        "",
    ]


def crashes(result):
    rows = [(row["what"], row["tried"], row["of"], row["failed"]) for row in result["rows"]]
    tried, failed = (sum(row[key] for row in result["rows"]) for key in ("tried", "failed"))
    return [
        "## Kills and faults at calls to the file system",
        "`make crash-test` kills the program, fills its disk or fails a read at each call that touches the output",
        "folder (or the video), and starts it again: the files must be the same, byte for byte, as those of an",
        "undisturbed run. A run with a fault must end with exit code 1 and an error, or with its result; the same",
        "run over a finished one must not do a stage again because a read failed. The disk",
        "is full from each call on that needs space. Reads are tried in an order that spreads over the run, so a",
        f"row that is not complete is a sample of its calls. Of {tried} runs {failed} failed.",
        "",
        *table(["what", "calls tried", "calls there are", "failed"], rows),
    ]


def sanitizers(result):
    rows = [(row["what"], f"`{row['command']}`", cell(row["said"])) for row in result["rows"]]
    return [
        "## Sanitizers, Miri and advisories",
        "`make sanitize`, the last log:",
        "",
        *table(["what", "command", "what it said"], rows),
    ]


def resources(result):
    rows = [(row["what"], row["asked"], row["found"] + ("" if row["kept"] else " (not kept)"))
            for check in result.values() for row in check]
    return [
        "## Promises about memory, threads and numbers",
        "`tools/reliability/resources.py`:",
        "",
        *table(["what", "asked", "found"], rows),
    ]


HEAD = """# Reliability

What was done to break the program, with what result, and the commands that do it again.
"""


def page(folder):
    lines = HEAD.split("\n")
    parts = [("scenes.json", degenerate), ("models.json", mutated), ("flags.json", flags), ("fuzz.json", fuzzing), ("crashes.json", crashes),
             ("sanitize.json", sanitizers), ("resources.json", resources)]
    for name, part in parts:
        result = read(folder, name)
        if result is not None:
            lines += part(result)
    with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "borders.md")) as file:
        lines += file.read().rstrip("\n").split("\n")
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results")
    parser.add_argument("--out", required=True)
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    text = page(args.results)
    if args.check:
        with open(args.out) as file:
            sys.exit(0 if file.read() == text else f"{args.out} is not what the results say")
    with open(args.out, "w") as file:
        file.write(text)


if __name__ == "__main__":
    main()
