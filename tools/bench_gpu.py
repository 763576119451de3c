#!/usr/bin/env python3
"""Everything that needs a graphics card, in under ten minutes, as JSON.

    bench_gpu.py BENCH SHARED --out FILE [--gpu NAME]

BENCH is splat's example `bench_gpu`. Where there is only an emulated adapter the same runs are made small (a dry run,
marked as such). Where torch and gsplat can be imported and find a card, gsplat renders and trains synthetic scenes of
the same numbers and kinds of Gaussians in the same call. Memory is the highest of one-second samples of nvidia-smi.
"""
import argparse
import json
import os
import shutil
import subprocess
import threading
import time

LONGEST = 570  # seconds
SYNTHETIC = [(60_000, 640, 480), (1_000_000, 1920, 1080), (5_000_000, 1920, 1080)]
DATASETS = ["lego400", "fox_undistorted_640"]


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


def ours(args, flags, seconds):
    """One call of the example; what went wrong in place of a result."""
    command = [args.bench, "--backend", "gpu"] + (["--gpu", args.gpu] if args.gpu else []) + flags
    print("  " + " ".join(command), flush=True)
    begun = time.time()
    try:
        with Memory() as memory:
            answer = subprocess.run(command, capture_output=True, text=True, timeout=max(seconds, 1))
    except subprocess.TimeoutExpired:
        return {"error": f"not done after {seconds:.0f} s", "flags": flags}
    if answer.returncode != 0:
        return {"error": answer.stderr.strip().splitlines()[-1:], "flags": flags}
    return json.loads(answer.stdout) | {"wall_s": time.time() - begun, "nvidia_smi": memory.record()}


def gsplat_scene(torch, n):
    """The same kind of ball as the example's."""
    torch.manual_seed(1)

    def unit(*shape):
        return torch.rand(*shape, device="cuda") * 2 - 1

    means = torch.nn.functional.normalize(unit(n, 3), dim=1) * unit(n, 1).abs() ** (1 / 3)
    scales = torch.log(torch.tensor(0.6 * n ** (-1 / 3), device="cuda")) + unit(n, 3)
    harmonics = torch.cat([unit(n, 1, 3), 0.1 * unit(n, 15, 3)], dim=1)
    return [v.requires_grad_() for v in (means, scales, unit(n, 4), 2 * unit(n), harmonics)]


def gsplat_run(n, width, height, repeat):
    """Median milliseconds of a picture and of a step (picture, L1 + D-SSIM, backward, fused Adam)."""
    import torch
    from gsplat import rasterization

    means, scales, quats, logits, harmonics = parameters = gsplat_scene(torch, n)
    eye = torch.tensor([2.5, 0.4, 0.3], device="cuda")
    forward = torch.nn.functional.normalize(-eye, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0], device="cuda")), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    view = torch.eye(4, device="cuda")
    view[:3, :3], view[:3, 3] = rotation, -rotation @ eye
    k = torch.tensor([[height, 0, width / 2], [0, height, height / 2], [0, 0, 1.0]], device="cuda")

    def render():
        return rasterization(means, quats, scales.exp(), logits.sigmoid(), harmonics, view[None], k[None],
                             width, height, sh_degree=3, packed=False)[0][0]

    d = torch.arange(11, device="cuda") - 5.0
    window = torch.exp(-d * d / 4.5)
    window = (window / window.sum()).view(1, 1, 1, 11).expand(3, 1, 1, 11).contiguous()

    def blur(x):
        x = torch.nn.functional.conv2d(x, window, padding=(0, 5), groups=3)
        return torch.nn.functional.conv2d(x, window.transpose(2, 3), padding=(5, 0), groups=3)

    def loss(x, y):
        l1 = (x - y).abs().mean()
        x, y = x.permute(2, 0, 1)[None], y.permute(2, 0, 1)[None]
        mx, my = blur(x), blur(y)
        sx, sy, sxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
        ssim = (2 * mx * my + 1e-4) * (2 * sxy + 9e-4) / ((mx * mx + my * my + 1e-4) * (sx + sy + 9e-4))
        return 0.8 * l1 + 0.2 * (1 - ssim.mean())

    with torch.no_grad():
        target = render().clamp(0, 1)
    adam = torch.optim.Adam(parameters, lr=1e-9, fused=True)

    def step():
        adam.zero_grad()
        loss(render(), target).backward()
        adam.step()

    def picture():
        with torch.no_grad():
            render()

    def median(call):
        spent = []
        for i in range(repeat + 3):
            torch.cuda.synchronize()
            begun = time.perf_counter()
            call()
            torch.cuda.synchronize()
            if i >= 3:
                spent.append((time.perf_counter() - begun) * 1e3)
        return sorted(spent)[repeat // 2]

    return {"gaussians": n, "size": [width, height], "forward_ms": median(picture), "step_ms": median(step),
            "memory_mib": torch.cuda.max_memory_allocated() / 2**20}


def gsplat(scenes):
    try:
        import gsplat as module
        import torch
        if not torch.cuda.is_available():
            return {"missing": "torch finds no card"}
    except ImportError as error:
        return {"missing": str(error)}
    results = []
    for n, width, height in scenes:
        try:
            results.append(gsplat_run(n, width, height, 20))
        except Exception as error:  # out of memory, a kernel that does not compile: the others still count
            results.append({"gaussians": n, "error": str(error)[:300]})
    return {"version": module.__version__, "torch": torch.__version__, "synthetic": results}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bench")
    parser.add_argument("shared")
    parser.add_argument("--out", required=True)
    parser.add_argument("--gpu", help="adapter to use")
    args = parser.parse_args()
    begun = time.time()
    probe = ours(args, ["--synthetic", "1000:64x48", "--repeat", "1"], 60)
    if "error" in probe:
        raise SystemExit(f"the GPU backend does not start: {probe['error']}")
    dry = probe["backend"].find("(software") >= 0
    print(f"{probe['backend']}{': a dry run' if dry else ''}")
    left = lambda: LONGEST - (time.time() - begun)
    record = {"adapter": probe["backend"], "adapters": probe["adapters"], "dry_run": dry, "runs": []}
    scenes = [(2_000, 128, 96), (10_000, 160, 120)] if dry else SYNTHETIC
    for n, w, h in scenes:
        flags = ["--synthetic", f"{n}:{w}x{h}", "--repeat", "2" if dry else "50"]
        record["runs"].append(ours(args, flags, min(left(), 120)))
    for name in DATASETS:
        folder = os.path.join(args.shared, "data", name)
        if not os.path.isdir(folder):
            record["runs"].append({"missing": folder})
            continue
        small = ["--iterations", "30", "--coarse-levels", "4", "--max-gaussians", "400", "--sh-degree", "1"]
        record["runs"].append(ours(args, ["--dataset", folder] + (small if dry else []), min(left(), 200)))
        if dry:
            break
    record["gsplat"] = {"missing": "a dry run"} if dry else gsplat(scenes)
    record["seconds"] = time.time() - begun
    os.makedirs(os.path.dirname(os.path.abspath(args.out)), exist_ok=True)
    with open(args.out, "w") as file:
        json.dump(record, file, indent=1)
    for run in record["runs"]:
        for scene in run.get("synthetic", []):
            print(f"{scene['gaussians']} gaussians {scene['size']}: picture {scene['forward']['ms']:.3f} ms, "
                  f"step {scene['step']['ms']:.3f} ms, {scene['memory_mib']:.0f} MiB")
        for scene in run.get("datasets", []):
            print(f"{scene['name']}: {scene['iterations']} steps in {scene['seconds']:.1f} s, "
                  f"{scene['psnr_held_out']:.2f} dB held out, picture {scene['picture_ms']:.2f} ms")
        if "error" in run:
            print(f"failed: {run['error']}")
    print(f"gsplat: {json.dumps(record['gsplat'])}")
    print(f"{record['seconds']:.0f} s; {args.out}")


if __name__ == "__main__":
    main()
