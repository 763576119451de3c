#!/usr/bin/env python3
"""Measures whether --threads and --memory-limit are kept, and looks for invalid floating-point
operations.

    resources.py PROGRAM --out FOLDER [--results FILE]

The input is data/sample/orbit.mp4. Threads that run or wait for a processor are counted fifty times
a second, those of child processes too; memory is the peak that the system counted. Under limits of
setrlimit (`ulimit -d`) and of --memory-limit a run must end with its result, or with exit code 1
and advice. fpe.c lists invalid operations. Exits with 1 where a promise was not kept. Linux.
"""
import argparse
import json
import os
import resource
import subprocess
import sys
import time

import harness

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
VIDEO = os.path.join(ROOT, "data/sample/orbit.mp4")
RUN = ["--frames", "16", "--max-size", "240", "--iterations", "100", "--max-gaussians", "4000", "-q"]
LIMITS = [20, 40, 60, 80, 120, 160, 240, 400]  # MiB


def runnable(pid):
    """Threads of a process and its children that run or wait for a processor."""
    count = 0
    try:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/stat") as file:
                count += file.read().rsplit(")", 1)[1].split()[0] == "R"
            with open(f"/proc/{pid}/task/{task}/children") as file:
                count += sum(runnable(int(child)) for child in file.read().split())
    except (FileNotFoundError, ProcessLookupError):
        pass  # it has ended
    return count


def busiest(command):
    """Exit code of a run, and the share of samples with more runnable threads than each number."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
    counts = []
    while child.poll() is None:
        counts.append(runnable(child.pid))
        time.sleep(0.02)
    return child.returncode, counts


def threads(program, out):
    rows = []
    for asked in (1, 2):
        code, counts = busiest([program, VIDEO, "-o", harness.fresh(os.path.join(out, "threads")), "--threads", str(asked), *RUN])
        above = sum(count > asked for count in counts) / max(len(counts), 1)
        found = f"at most {max(counts)} at once, more than {asked} in {100 * above:.1f} % of {len(counts)} looks"
        rows.append({"what": f"`--threads {asked}`: runnable threads, children included", "asked": f"{asked}", "found": found,
                     "kept": code in (0, 3) and above < 0.05})
    return rows


def limited(program, out, limit, is_flag):
    """One run under a limit of MiB."""
    folder = harness.fresh(os.path.join(out, "memory"))
    more = {} if is_flag else {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_DATA, (limit << 20, limit << 20))}
    flags = ["--memory-limit", str(limit)] if is_flag else []
    told = harness.run("/usr/bin/time", ["-f", "PEAK %M", program, VIDEO, "-o", folder, "--threads", "2", *RUN, *flags], **more)
    peak = [line.split()[-1] for line in told["said"].splitlines() if line.startswith("PEAK")]
    peak = int(peak[-1]) / 1024 if peak else float("nan")
    advised = told["code"] == 1 and any(word in told["said"] for word in ("lower", "raise", "memory"))
    kept = (told["code"] in (0, 3) or advised) and not harness.crashed(told) and not peak > limit + 30
    how = "`--memory-limit`" if is_flag else "setrlimit"
    found = f"exit code {told['code']}{' with advice' if advised else ''}, peak {peak:.0f} MiB"
    if not kept:
        print(f"{how} {limit}: {told['said'][-400:]}")
    return {"what": f"{how} of {limit} MiB", "asked": f"a result, or advice; at most {limit} MiB and the program itself (30)",
            "found": found, "kept": kept}


def numbers(program, out):
    """Invalid operations of a run on the sample."""
    library, log = os.path.join(out, "fpe.so"), os.path.join(out, "fpe.log")
    source = os.path.join(ROOT, "tools/reliability/fpe.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    folder = harness.fresh(os.path.join(out, "numbers"))
    told = harness.run(program, [VIDEO, "-o", folder, "--quality", "draft", "-q"], 3000,
                       env={**os.environ, "LD_PRELOAD": library, "FPE_LOG": log})
    with open(log) as file:
        lines = [line.split() for line in file if line.strip()]
    scalar = [line for line in lines if "scalar" in line]
    print("invalid operations:", lines)
    return {"what": "invalid floating-point operations in a whole run on the sample (`--quality draft`)", "asked": "none",
            "found": f"{len(scalar)} places of single numbers ({len(lines) - len(scalar)} packed, on unused lanes)",
            "kept": not scalar and told["code"] in (0, 3)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--out", required=True)
    parser.add_argument("--results")
    args = parser.parse_args()
    program, out = os.path.abspath(args.program), harness.fresh(os.path.abspath(args.out))
    rows = threads(program, out)
    rows += [limited(program, out, limit, is_flag) for is_flag in (True, False) for limit in LIMITS]
    rows.append(numbers(program, out))
    for row in rows:
        print("kept" if row["kept"] else "NOT KEPT", row["what"], "|", row["found"], flush=True)
    if args.results:
        with open(args.results, "w") as file:
            json.dump({"rows": rows}, file, indent=1)
            file.write("\n")
    sys.exit(0 if all(row["kept"] for row in rows) else 1)


if __name__ == "__main__":
    main()
