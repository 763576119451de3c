#!/usr/bin/env python3
"""The paper's three tables (quality, training cost, rendering cost) for the methods that the program
has, the paper's rows beside them.

    paper_tables.py SAT_RECON SHARED --out FOLDER [--testbed FOLDER] [--quality fast] [--only CASE ...]
                    [--methods 3dgs instant-ngp] [--time-limit 5m]

With --time-limit each method has the same time for training (--limit-clock processor: the processor
time of as many cores in that time, whatever else the machine does); without, the steps of --quality.

Runs sat-recon on test-bed cases 1 to 4 (as `make testbed` renders them; case 3 is in
data/testbed), temple_ring, can_orbit and oxford_dino, and writes FOLDER/tables.{md,csv,tex,json}
and FOLDER/runs.html. A case whose capture is missing is named and left out; a run that is finished
is not repeated. The paper's captures are real and not public, ours of the same cases are
simulated: its rows tell the order of magnitude, not who is better.
"""
import argparse
import json
import os
import subprocess
import sys

import bench_results

HERE = os.path.dirname(os.path.abspath(__file__))
PAPER = os.path.join(HERE, "../docs/paper.json")


def captures(shared, testbed):
    """Case name and where its capture may lie, in the order of the tables."""
    bed = [testbed, os.path.join(HERE, "../data/testbed")]
    kinds = ["video.mp4", "images"]  # a yaw is a video, an orbit a folder of stills
    cases = [(f"case {i}", [os.path.join(b, f"case{i}", k) for b in bed for k in kinds]) for i in range(1, 5)]
    real = [("temple_ring", "temple_ring/images"), ("can_orbit", "phone_video/can_orbit.mp4"),
            ("oxford_dino", "oxford_dino/images")]
    return cases + [(name, [os.path.join(shared, "data", path)]) for name, path in real]


def is_finished(folder):
    path = os.path.join(folder, "run.json")
    return os.path.exists(path) and json.load(open(path))["evaluation"] is not None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--testbed", default=os.path.join(HERE, "../build/testbed"))
    parser.add_argument("--quality", default="fast", choices=["draft", "fast", "balanced", "best"])
    parser.add_argument("--only", nargs="*", help="names of cases")
    parser.add_argument("--methods", nargs="+", default=["3dgs"], help="as for sat-recon --method")
    parser.add_argument("--time-limit", help="time for each training, as for sat-recon")
    parser.add_argument("--limit-clock", default="wall", choices=["wall", "processor"])
    args = parser.parse_args()
    runs = []
    for case, places in captures(args.shared, args.testbed):
        if args.only and case not in args.only:
            continue
        source = next((p for p in places if os.path.exists(p)), None)
        if source is None:
            print(f"{case}: no capture (looked at {', '.join(places)})", file=sys.stderr)
            continue
        runs += [run for method in args.methods if (run := trained(args, case, source, method))]
    if not runs:
        sys.exit("there is nothing to tabulate")
    subprocess.run([args.binary, "compare", *runs, "--beside", PAPER, "--tables", args.out,
                    "--report", os.path.join(args.out, "runs.html")], check=True)
    keep(args.out)


def trained(args, case, source, method):
    """The run of a case by a method, as `compare` names it; None where it failed."""
    budget = args.time_limit or args.quality
    shown = f"sat-recon {budget}" if method == "3dgs" else f"{method} {budget}"
    folder = os.path.join(args.out, shown.removeprefix("sat-recon ").replace(" ", "-"), case.replace(" ", ""))
    if not is_finished(folder):
        command = [args.binary, source, "-o", folder, "-q", "--quality", args.quality, "--method", method]
        limit = ["--time-limit", args.time_limit, "--limit-clock", args.limit_clock] if args.time_limit else []
        code = subprocess.run(command + limit).returncode
        if code not in (0, 3):
            print(f"{case}, {method}: exit code {code}", file=sys.stderr)
            return None
    return f"{shown}:{case}={folder}"


def keep(folder):
    """The tables as benchmarks_page.py reads them: methods as rows, and in each cell what a case's
    columns hold."""
    with open(os.path.join(folder, "tables.json")) as file:
        tables = json.load(file)
    for table in tables:
        names = ", ".join(column["name"] for column in table["columns"])
        columns = [f"{table['title']}: {names}", *table["cases"]]
        shown = bench_results.Table(os.path.join(folder, "results"), "paper_" + table["title"].split()[0], columns)
        for method, cases in zip(table["methods"], table["values"]):
            shown.row([method, *(values(case, table["columns"]) for case in cases)])


def values(case, columns):
    """The figures of one case, with the digits of their columns."""
    shown = ["–" if v is None else f"{v:.{c['digits']}f}" for v, c in zip(case or [None] * len(columns), columns)]
    return "–" if set(shown) == {"–"} else ", ".join(shown)


if __name__ == "__main__":
    main()
