#!/usr/bin/env python3
"""The tables of docs/benchmarks.md on graphics cards, from what bench_gpu.py wrote.

    bench_gpu_tables.py BENCH_GPU_JSON --out RESULTS

Left out where the adapter was an emulated one.
"""
import argparse
import json
import os

from bench_results import version

KERNELS = ["project", "sort", "forward", "loss", "backward", "optimise"]


def kernels(record, peers):
    """Milliseconds of a step by kernel, beside the longer of the two floors."""
    rows = []
    for run in record["synthetic"]:
        for scene in run.get("synthetic", []):
            peer = next((p for p in peers if p.get("gaussians") == scene["gaussians"]), {})
            row = [f"{scene['gaussians']:,}, {scene['size'][0]} × {scene['size'][1]}", f"{scene['pairs']:,}"]
            for name in KERNELS:
                k = scene["kernels"][name]
                floor = max(k["bandwidth_floor_ms"], k["arithmetic_floor_ms"])
                row.append(f"{k['ms']:.2f} ({floor:.2f})")
            row += [f"{scene['step']['ms']:.2f}", f"{peer['step_ms']:.2f}" if "step_ms" in peer else "–"]
            row += [f"{scene['forward']['ms']:.2f}", f"{peer['forward_ms']:.2f}" if "forward_ms" in peer else "–"]
            rows.append(row + [f"{scene['memory_mib']:.0f}"])
    columns = ["Gaussians, picture", "pairs"] + [f"{name} (floor), ms" for name in KERNELS]
    return columns + ["step, ms", "gsplat", "picture, ms", "gsplat", "MiB"], rows


def training(record, peers):
    """Seconds and held-out PSNR of trainings of several lengths, ours on the card, gsplat, ours on
    the processor."""
    rows = []
    for kind, label in (("gpu", "sat-recon, card"), ("cpu", "sat-recon, processor")):
        for run in record[kind]:
            for d in run.get("datasets", []):
                rows.append([d["name"], label, f"{d['iterations']:,}", f"{d['seconds']:.1f}", f"{d['cpu_seconds']:.1f}",
                             f"{d['psnr_held_out']:.2f}", f"{d['gaussians']:,}"])
    for d in peers:
        for p in d.get("curve", []):
            rows.append([d["name"], "gsplat, card", f"{p['iteration']:,}", f"{p['seconds']:.1f}", "–",
                         f"{p['psnr_held_out']:.2f}", f"{p['gaussians']:,}"])
    rows.sort(key=lambda row: (row[0], row[1], int(row[2].replace(",", ""))))
    return ["data set", "trainer", "steps", "wall s", "CPU s", "held-out PSNR", "Gaussians"], rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record")
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    with open(args.record) as file:
        record = json.load(file)
    if record["dry_run"]:
        return
    os.makedirs(args.out, exist_ok=True)
    peer, roof = record["gsplat"], record["roof"]
    note = f"gsplat {peer['version']}, torch {peer['torch']}" if "version" in peer else "gsplat was not there"
    machine = (f"{record['adapter']}: {roof['bytes_a_second'] / 1e12:.2f} TB/s copied by a kernel, "
               f"{roof['flop_a_second'] / 1e12:.1f} TFLOP/s of f32; {note}")
    for name, make, peers in (("gpu_kernels", kernels, peer.get("synthetic", [])), ("gpu_training", training, peer.get("datasets", []))):
        columns, rows = make(record, peers)
        table = {"table": name, "version": record.get("version", version()), "machine": machine, "columns": columns, "rows": rows}
        with open(os.path.join(args.out, name + ".json"), "w") as file:
            json.dump(table, file, indent=1, ensure_ascii=False)


if __name__ == "__main__":
    main()
