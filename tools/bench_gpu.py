#!/usr/bin/env python3
"""Everything that needs a graphics card, in under ten minutes, as JSON, with a plot of the
speed-accuracy curves beside it.

    bench_gpu.py BENCH SHARED --out FILE [--gpu NAME] [--sat-recon PROGRAM] [--python PYTHON]

BENCH is splat's example `bench_gpu`. Where there is only an emulated adapter the same runs are made
small (a dry run, marked as such; the scenes of 1 and 5 million Gaussians are left out and it is
said). gsplat runs in PYTHON (bench_gpu_gsplat.py) on the same scenes, numbers of Gaussians and data
sets. temple_ring has no posed copy: PROGRAM solves it. Memory is the highest of one-second samples
of nvidia-smi, where that is there.
"""
import argparse
import json
import os
import shutil
import subprocess
import sys
import threading
import time

from bench_results import version

LONGEST = 570  # seconds
SYNTHETIC = ["60000:640x480", "1000000:1920x1080", "5000000:1920x1080"]
SMALL = ["2000:128x96", "6000:160x120"]
DATASETS = ["lego400", "temple_ring", "fox_undistorted_640"]
CURVE = [500, 1000, 2000, 4000]


class Memory:
    """Highest MiB in use on the first card while it runs, and how much was in use before."""

    def __enter__(self):
        self.samples, self.end = [], threading.Event()
        self.before = self.sample()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self

    def sample(self):
        if shutil.which("nvidia-smi") is None:
            return None
        command = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "--id=0"]
        answer = subprocess.run(command, capture_output=True, text=True)
        return float(answer.stdout.split()[0]) if answer.returncode == 0 and answer.stdout.split() else None

    def watch(self):
        while not self.end.wait(1):
            self.samples.append(self.sample())

    def __exit__(self, *_):
        self.end.set()
        self.thread.join()

    def record(self):
        seen = [s for s in self.samples if s is not None]
        return {"before_mib": self.before, "highest_mib": max(seen)} if seen else None


def call(command, seconds):
    """The JSON object that a program prints, its time and memory; what went wrong in place of a
    result."""
    print(f"  {' '.join(command)}", flush=True)
    begun = time.time()
    try:
        with Memory() as memory:
            answer = subprocess.run(command, capture_output=True, text=True, timeout=max(seconds, 1))
    except subprocess.TimeoutExpired:
        return {"error": f"not done after {seconds:.0f} s"}
    except OSError as error:
        return {"error": str(error)}
    if answer.returncode != 0:
        return {"error": " ".join(answer.stderr.strip().splitlines()[-1:]) or f"exit code {answer.returncode}"}
    result = json.loads(answer.stdout) if answer.stdout.strip() else {}
    return result | {"wall_s": time.time() - begun, "nvidia_smi": memory.record()}


def floors(scene, roof):
    """Milliseconds that each kernel needs at least: its bytes at the adapter's bandwidth, its
    operations at its rate."""
    if not roof:
        return {}
    out = {}
    for name, ms in scene["step"]["kernels_ms"].items():
        moved = scene["bytes"].get(name, 0) / roof["bytes_a_second"] * 1e3
        computed = scene["flop"].get(name, 0) / roof["flop_a_second"] * 1e3
        out[name] = {"ms": ms, "bandwidth_floor_ms": moved, "arithmetic_floor_ms": computed}
    return out


def posed(args, folder, work, seconds):
    """The data set as it is, or solved first where it has no poses; nothing where that cannot be
    done."""
    if os.path.isdir(os.path.join(folder, "sparse")) or os.path.isfile(os.path.join(folder, "transforms.json")):
        return folder
    if not args.sat_recon or not os.path.isdir(os.path.join(folder, "images")):
        return None
    out = os.path.join(work, os.path.basename(folder))
    command = [args.sat_recon, os.path.join(folder, "images"), "-o", out, "--quality", "draft", "--iterations", "1"]
    print(f"  {' '.join(command)}", flush=True)
    try:
        subprocess.run(command, capture_output=True, timeout=max(seconds, 1))
    except (subprocess.TimeoutExpired, OSError):
        return None
    solved = os.path.join(out, "undistorted")
    if not os.path.isdir(solved):
        return None
    named = os.path.join(work, "posed", os.path.basename(folder))
    shutil.rmtree(named, ignore_errors=True)
    shutil.copytree(solved, named)
    return named


def time_to(points, psnr):
    """Seconds of the first point that reaches a PSNR; nothing if none does."""
    return min((p["seconds"] for p in points if p["psnr_held_out"] >= psnr), default=None)


def versus(ours, theirs):
    """Time to the PSNR that both reach, less 0.25 dB: the levels are not the same runs'."""
    if not ours or not theirs:
        return None
    level = min(max(p["psnr_held_out"] for p in ours), max(p["psnr_held_out"] for p in theirs)) - 0.25
    a, b = time_to(ours, level), time_to(theirs, level)
    return {"psnr": level, "ours_s": a, "gsplat_s": b, "ratio": a / b if a and b else None}


def plot(path, curves):
    """Held-out PSNR over seconds (logarithmic), a line a trainer and data set, as SVG."""
    import math
    points = [p for _, line in curves for p in line]
    if not points:
        return
    xs, ys = [math.log10(p["seconds"]) for p in points], [p["psnr_held_out"] for p in points]
    x0, x1, y0, y1 = min(xs), max(max(xs), min(xs) + 1e-3), min(ys) - 0.5, max(ys) + 0.5
    at = lambda p: (60 + 560 * (math.log10(p["seconds"]) - x0) / (x1 - x0), 360 - 320 * (p["psnr_held_out"] - y0) / (y1 - y0))
    colours = ["#4269d0", "#efb118", "#ff725c", "#6cc5b0", "#3ca951", "#ff8ab7", "#a463f2", "#97bbf5", "#9c6b4e"]
    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="860" height="420" font-family="sans-serif" font-size="12">',
           '<rect width="860" height="420" fill="white"/><path d="M60 40V360H620" fill="none" stroke="black"/>']
    for k in range(5):
        s, v = 10 ** (x0 + (x1 - x0) * k / 4), y0 + (y1 - y0) * k / 4
        out.append(f'<text x="{60 + 140 * k}" y="378" text-anchor="middle">{s:.3g}</text>')
        out.append(f'<text x="54" y="{364 - 80 * k}" text-anchor="end">{v:.1f}</text>')
    out.append('<text x="340" y="400" text-anchor="middle">seconds of training</text>')
    out.append('<text x="60" y="28">PSNR of held-out views, dB</text>')
    for i, (name, line) in enumerate(curves):
        colour = colours[i % len(colours)]
        where = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, sorted(line, key=lambda p: p["seconds"])))
        out.append(f'<polyline points="{where}" fill="none" stroke="{colour}" stroke-width="2"/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in map(at, line)]
        out.append(f'<text x="640" y="{52 + 18 * i}" fill="{colour}">{name}</text>')
    with open(path, "w") as file:
        file.write("\n".join(out + ["</svg>\n"]))


def measure(args, record, left, work):
    dry, ours = record["dry_run"], [args.bench, "--backend", "gpu"] + (["--gpu", args.gpu] if args.gpu else [])
    scenes = SMALL if dry else SYNTHETIC
    if dry:
        record["left_out"] = f"an emulated adapter: {', '.join(SYNTHETIC)}"
        print(f"left out, as it is {record['left_out']}")
    for scene in scenes:
        run = call(ours + ["--synthetic", scene, "--repeat", "2" if dry else "50"], min(left(), 90))
        for result in run.get("synthetic", []):
            result["kernels"] = floors(result, record["roof"])
        record["synthetic"].append(run)
    steps = [str(n) for n in ([10, 20] if dry else CURVE)]
    small = ["--coarse-levels", "4", "--max-gaussians", "300", "--sh-degree", "1", "--score", "2"] if dry else []
    folders = []
    for name in DATASETS[:1] if dry else DATASETS:
        folder = posed(args, os.path.join(args.shared, "data", name), work, min(left(), 60))
        if folder is None or not os.path.isdir(folder):
            record["gpu"].append({"missing": name})
            continue
        folders.append(folder)
        record["gpu"].append(call(ours + ["--dataset", folder, "--curve"] + steps + small, min(left(), 240 if dry else 90)))
    # gsplat and the processor share what is left.
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "bench_gpu_gsplat.py")
    exported = [os.path.join(work, "export", os.path.basename(f)) for f in folders]
    for folder in folders:
        call([args.bench, "--export", os.path.join(work, "export"), "--dataset", folder], min(left(), 30))
    flags = ["--scene"] + scenes + ["--data"] + exported + ["--seconds", "40"]
    record["gsplat"] = call([args.python, script] + flags, left() - 60)
    for folder in folders:
        if left() > 20:
            cpu = [args.bench, "--backend", "cpu", "--dataset", folder, "--curve"] + steps[:2 if dry else 3] + small
            record["cpu"].append(call(cpu, min(left(), 60)))


def curves_of(record):
    lines, compared = [], {}
    for kind in ("gpu", "cpu"):
        for run in record[kind]:
            points = run.get("datasets", [])
            if points:
                lines.append((f"{points[0]['name']}, {kind}", points))
    for run in record["gsplat"].get("datasets", []):
        if run.get("curve"):
            lines.append((f"{run['name']}, gsplat", run["curve"]))
            ours = next((line for name, line in lines if name == f"{run['name']}, gpu"), None)
            compared[run["name"]] = versus(ours, run["curve"])
    return lines, compared


def say(record):
    for run in record["synthetic"]:
        for scene in run.get("synthetic", []):
            print(f"{scene['gaussians']} gaussians {scene['size']}: picture {scene['forward']['ms']:.3f} ms, "
                  f"step {scene['step']['ms']:.3f} ms, {scene['memory_mib']:.0f} MiB, {scene['pairs']} pairs")
            for name, k in scene["kernels"].items():
                print(f"    {name:9} {k['ms']:9.3f} ms   floors: bandwidth {k['bandwidth_floor_ms']:8.4f}, "
                      f"arithmetic {k['arithmetic_floor_ms']:8.4f}")
    for run in record["gpu"] + record["cpu"]:
        for scene in run.get("datasets", []):
            print(f"{scene['name']}: {scene['iterations']} steps in {scene['seconds']:.1f} s ({scene['cpu_seconds']:.1f} CPU s), "
                  f"{scene['psnr_held_out']:.2f} dB held out, {scene['gaussians']} gaussians, "
                  f"step {scene['scene']['step']['ms']:.3f} ms of {scene['scene']['pairs']} pairs")
    for run in record["synthetic"] + record["gpu"] + record["cpu"]:
        for key in ("error", "missing"):
            if key in run:
                print(f"{key}: {run[key]}")
    print(f"gsplat: {json.dumps(record['gsplat'])[:2000]}")
    print(f"time to PSNR: {json.dumps(record['time_to_psnr'])}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bench")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--gpu", help="adapter to use")
    parser.add_argument("--sat-recon", help="solves the data sets that have no poses")
    parser.add_argument("--python", default=sys.executable, help="has torch and gsplat")
    parser.add_argument("--seconds", type=float, default=LONGEST, help="after which nothing more is begun")
    args = parser.parse_args()
    begun = time.time()
    left = lambda: args.seconds - (time.time() - begun)
    probe = call([args.bench, "--backend", "gpu", "--roof", "--synthetic", "1000:64x48", "--repeat", "1"]
                 + (["--gpu", args.gpu] if args.gpu else []), 120)
    if "error" in probe:
        raise SystemExit(f"the GPU backend does not start: {probe['error']}")
    dry = "(software" in probe["backend"]
    print(f"{probe['backend']}{': a dry run' if dry else ''}")
    record = {"version": version(), "adapter": probe["backend"], "adapters": probe["adapters"], "roof": probe["roof"], "dry_run": dry,
              "synthetic": [], "gpu": [], "cpu": [], "gsplat": {}}
    work = os.path.splitext(os.path.abspath(args.out))[0] + "_work"
    os.makedirs(work, exist_ok=True)
    try:
        measure(args, record, left, work)
    finally:
        lines, record["time_to_psnr"] = curves_of(record)
        plot(os.path.splitext(args.out)[0] + ".svg", lines)
        record["seconds"] = time.time() - begun
        with open(args.out, "w") as file:
            json.dump(record, file, indent=1)
        shutil.rmtree(work, ignore_errors=True)
    say(record)
    print(f"{record['seconds']:.0f} s; {args.out}")


if __name__ == "__main__":
    main()
