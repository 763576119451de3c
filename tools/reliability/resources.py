#!/usr/bin/env python3
"""Measures whether --threads and --memory-limit are kept, what a long video and many photos need,
and looks for invalid floating-point operations.

    resources.py PROGRAM --out FOLDER [--only WORD...] [--results FILE]

The input is data/sample/orbit.mp4. The cores that a run keeps busy are those of child processes too, and
no more than others leave to it; memory is the peak that the system counted, of the largest
process. Under limits of setrlimit (`ulimit -d`, `ulimit -n`) and of --memory-limit a run must end
with its result, or with exit code 1 and advice. The long video is a pattern of 3840 x 2160 pixels
at two lengths, the photos are different windows of the sample's frames, of which one part in a
thousand of the pairs is matched; what 5,000 need is also extrapolated by the line through the last
two numbers of them. fpe.c lists invalid operations. --only takes the checks whose
names hold one of the words. Results are kept after each row. Exits with 1 where a promise was not
kept. Linux.
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
RUN = ["--frames", "8", "--max-size", "160", "--iterations", "50", "--max-gaussians", "2000", "-q"]
LIMITS = [20, 40, 60, 80, 120, 160, 240, 400]  # MiB
LEAST_LIMIT = 64  # MiB; --memory-limit takes no less
DESCRIPTORS = [4, 8, 12, 16, 24, 32, 64]
MINUTES = [1, 20]  # of the 4K video
RATE = 2  # its frames a second
PHOTOS = [500, 1000, 2000, 5000]
MOST_MIB = 4096  # asked for both


def cpu_seconds(pid):
    """CPU time of a process and its children, the ended ones too."""
    ticks = 0
    try:
        with open(f"/proc/{pid}/stat") as file:
            ticks += sum(int(field) for field in file.read().rsplit(")", 1)[1].split()[11:15])
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/children") as file:
                ticks += sum(cpu_seconds(int(child)) for child in file.read().split()) * os.sysconf("SC_CLK_TCK")
    except (FileNotFoundError, ProcessLookupError):
        pass  # it has ended
    return ticks / os.sysconf("SC_CLK_TCK")


def busiest(command):
    """Exit code of a run, and the most cores that it kept busy over a second."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
    looks, most = [(time.monotonic(), 0.0)], 0.0
    while child.poll() is None:
        time.sleep(0.05)
        looks.append((time.monotonic(), cpu_seconds(child.pid)))
        before = next(look for look in reversed(looks) if looks[-1][0] - look[0] >= 1.0 or look is looks[0])
        if looks[-1][0] - before[0] >= 1.0:
            most = max(most, (looks[-1][1] - before[1]) / (looks[-1][0] - before[0]))
    return child.returncode, most


def threads(program, out):
    for asked in (1, 2):
        code, most = busiest([program, VIDEO, "-o", harness.fresh(os.path.join(out, "threads")), "--threads", str(asked), *RUN])
        yield {"what": f"`--threads {asked}`, ffmpeg beside it included", "asked": f"at most {asked} and ffmpeg's one core busy over a second",
               "found": f"at most {most:.1f} of {os.cpu_count()} cores, which others used too ({os.getloadavg()[0]:.0f} processes at once)",
               "kept": code in (0, 3) and most <= asked + 1}


def measured(program, arguments, **more):
    """What a run said, with its peak of memory, MiB."""
    told = harness.run("/usr/bin/time", ["-f", "PEAK %M", program, *arguments], 3000, **more)
    peak = [line.split()[-1] for line in told["said"].splitlines() if line.startswith("PEAK")]
    told["peak"] = int(peak[-1]) / 1024 if peak else float("nan")
    return told


def limited(program, out, limit, is_flag):
    """One run under a limit of MiB."""
    folder = harness.fresh(os.path.join(out, "memory"))
    more = {} if is_flag else {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_DATA, (limit << 20, limit << 20))}
    flags = ["--memory-limit", str(limit)] if is_flag else []
    told = measured(program, [VIDEO, "-o", folder, "--threads", "2", *RUN, *flags], **more)
    advised = told["code"] == 1 and "error: " in told["said"] and any(word in told["said"] for word in ("lower", "raise"))
    kept = (told["code"] in (0, 3) or advised) and not harness.crashed(told) and not told["peak"] > limit + 30
    how = "`--memory-limit`" if is_flag else "setrlimit"
    found = f"exit code {told['code']}{' with advice' if advised else ''}, peak {told['peak']:.0f} MiB"
    if not kept:
        print(f"{how} {limit}: {told['said'][-400:]}")
    return {"what": f"{how} of {limit} MiB", "asked": f"a result, or advice; at most {limit} MiB and the program itself (30)",
            "found": found, "kept": kept}


def memory(program, out):
    for is_flag in (True, False):
        for limit in LIMITS:
            if limit >= LEAST_LIMIT or not is_flag:
                yield limited(program, out, limit, is_flag)


def descriptors(program, out):
    for limit in DESCRIPTORS:
        folder = harness.fresh(os.path.join(out, "descriptors"))
        told = harness.run(program, [VIDEO, "-o", folder, "--threads", "2", *RUN],
                           preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit)))
        is_told = told["code"] == 1 and "error: " in told["said"] and "open files" in told["said"]
        kept = told["code"] in (0, 3) or is_told
        if not kept:
            print(f"{limit} descriptors: {told['said'][-400:]}")
        yield {"what": f"at most {limit} open files (`ulimit -n`)", "asked": "a result, or an error that names it",
               "found": f"exit code {told['code']}{', the error names it' if is_told else ''}", "kept": kept}


def long_video(program, out):
    """Memory of the selection of frames, of a short and of a long video."""
    peaks = []
    for minutes in MINUTES:
        video = os.path.join(harness.fresh(os.path.join(out, "long")), "video.mp4")
        pattern = f"testsrc2=size=3840x2160:rate={RATE}:duration={60 * minutes}"
        subprocess.run(["ffmpeg", "-v", "error", "-f", "lavfi", "-i", pattern, "-c:v", "libx264", "-preset", "ultrafast", video], check=True)
        told = measured(program, ["frames", video, "-o", os.path.join(out, "long/out"), "--threads", "2", "--frames", "20", "--key", "off", "-q"])
        peaks.append(told["peak"])
        share = f", {peaks[-1] / peaks[0]:.2f} of that of the shortest" if len(peaks) > 1 else ""
        yield {"what": f"`frames` of a 4K video, {minutes} min at {RATE} frames a second, 2 threads", "asked": f"at most {MOST_MIB} MiB",
               "found": f"exit code {told['code']}, peak {told['peak']:.0f} MiB{share}", "kept": told["code"] == 0 and peaks[-1] < MOST_MIB}


def many_photos(program, out):
    """Memory of reading, features and matching of many small photos."""
    window = "crop=320:240:mod(n*37\\,in_w-320):mod(n*23\\,in_h-240)"
    peaks = []
    for count in PHOTOS:
        photos = harness.fresh(os.path.join(out, "photos"))
        subprocess.run(["ffmpeg", "-v", "error", "-stream_loop", "-1", "-i", VIDEO, "-vf", window, "-frames:v", str(count), "-q:v", "3",
                        os.path.join(photos, "%05d.jpg")], check=True, stdin=subprocess.DEVNULL)
        told = measured(program, ["sfm", photos, "-o", harness.fresh(os.path.join(out, "many")), "--threads", "2",
                                  "--max-features", "1000", "--pairs", "1/1000"])
        print(told["said"][-600:])
        peaks.append((count, told["peak"]))
        yield {"what": f"`sfm --pairs 1/1000` of {count} photos of 320 × 240 pixels, at most 1,000 features each", "asked": f"at most {MOST_MIB} MiB",
               "found": f"exit code {told['code']}, peak {told['peak']:.0f} MiB{extrapolated(peaks)}",
               "kept": told["code"] in (0, 2, 3) and told["peak"] < MOST_MIB}


def extrapolated(peaks):
    """In words, what the most photos would need; empty where there are not two numbers, or it was measured."""
    if len(peaks) < 2 or peaks[-1][0] == PHOTOS[-1]:
        return ""
    (n, before), (m, after) = peaks[-2:]
    return f"; by the line through this and {n} photos {PHOTOS[-1]:,} need {after + (after - before) / (m - n) * (PHOTOS[-1] - m):.0f} MiB (extrapolated)"


def numbers(program, out):
    """Invalid operations of a run on the sample."""
    library, log = os.path.join(out, "fpe.so"), os.path.join(out, "fpe.log")
    source = os.path.join(ROOT, "tools/reliability/fpe.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    told = harness.run(program, [VIDEO, "-o", harness.fresh(os.path.join(out, "numbers")), *RUN], 3000,
                       env={**os.environ, "LD_PRELOAD": library, "FPE_LOG": log})
    with open(log) as file:
        lines = [line.split() for line in file if line.strip()]
    scalar = [line for line in lines if "scalar" in line]
    print("invalid operations:", lines)
    yield {"what": f"invalid floating-point operations in a whole run on the sample (`{' '.join(RUN[:-1])}`)", "asked": "none",
           "found": f"{len(scalar)} places of single numbers ({len(lines) - len(scalar)} packed, on unused lanes)",
           "kept": not scalar and told["code"] in (0, 3)}


CHECKS = {"threads": threads, "memory": memory, "descriptors": descriptors, "numbers": numbers, "long-video": long_video,
          "many-photos": many_photos}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--out", required=True)
    parser.add_argument("--only", nargs="+", default=list(CHECKS), choices=CHECKS)
    parser.add_argument("--results")
    args = parser.parse_args()
    program, out = os.path.abspath(args.program), harness.fresh(os.path.abspath(args.out))
    found = {}
    if args.results and os.path.exists(args.results):
        with open(args.results) as file:
            found = json.load(file)
    all_kept = True
    for name in args.only:
        found[name] = []
        for row in CHECKS[name](program, out):
            print("kept" if row["kept"] else "NOT KEPT", row["what"], "|", row["found"], flush=True)
            found[name].append(row)
            all_kept &= row["kept"]
            if args.results:
                with open(args.results, "w") as file:
                    json.dump({key: found[key] for key in CHECKS if key in found}, file, indent=1)
                    file.write("\n")
    sys.exit(0 if all_kept else 1)


if __name__ == "__main__":
    main()
