#!/usr/bin/env python3
"""gsplat on what `bench_gpu` measures: one JSON object on standard output.

    bench_gpu_gsplat.py [--scene N:WIDTHxHEIGHT ...] [--data FOLDER ...] [--iterations N] [--seconds S] [--device cuda]

FOLDERs are written by `bench_gpu --export`. gsplat and torch come from PyPI; gsplat compiles its
kernels at the first call. Where either is missing, or no card is found, the object says so.
Training: gsplat's own strategy and the step sizes of the 3DGS paper, from the same first Gaussians
as ours; the held-out views are scored at 8 bits while the clock stands still.
"""
import argparse
import json
import math
import os
import time

SIDES = [250, 500, 1000, 2000, 3000, 4500, 7000]  # steps after which the held-out views are scored


def load():
    import torch
    import gsplat
    return torch, gsplat


class Clock:
    """Wall milliseconds of work on a device that runs behind."""

    def __init__(self, torch, device):
        self.wait = torch.cuda.synchronize if device == "cuda" else lambda: None

    def now(self):
        self.wait()
        return time.perf_counter() * 1e3

    def median(self, call, repeat):
        spent = []
        for i in range(repeat + 3):
            begun = self.now()
            call()
            if i >= 3:
                spent.append(self.now() - begun)
        return sorted(spent)[repeat // 2]


def ssim(torch, device):
    """1 - SSIM of two pictures [H, W, 3]: 11 x 11 Gaussian window, sigma 1.5, zero padding (Wang et
    al. 2004)."""
    conv = torch.nn.functional.conv2d
    d = torch.arange(11, device=device) - 5.0
    window = torch.exp(-d * d / 4.5)
    window = (window / window.sum()).view(1, 1, 1, 11).expand(15, 1, 1, 11).contiguous()

    def distance(x, y):
        x, y = x.permute(2, 0, 1), y.permute(2, 0, 1)
        maps = torch.cat([x, y, x * x, y * y, x * y])[None]
        maps = conv(maps, window, padding=(0, 5), groups=15)
        mx, my, xx, yy, xy = conv(maps, window.transpose(2, 3), padding=(5, 0), groups=15)[0].split(3)
        s = (2 * mx * my + 1e-4) * (2 * (xy - mx * my) + 9e-4)
        return 1 - (s / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4))).mean()

    return distance


def ball(torch, n, device):
    """The same kind of ball as the example's."""
    torch.manual_seed(1)

    def unit(*shape):
        return torch.rand(*shape, device=device) * 2 - 1

    means = torch.nn.functional.normalize(unit(n, 3), dim=1) * unit(n, 1).abs() ** (1 / 3)
    scales = math.log(0.6 * n ** (-1 / 3)) + unit(n, 3)
    harmonics = torch.cat([unit(n, 1, 3), 0.1 * unit(n, 15, 3)], dim=1)
    return [v.requires_grad_() for v in (means, scales, unit(n, 4), 2 * unit(n), harmonics)]


def scene(torch, gsplat, text, repeat, device):
    """Median milliseconds of a picture and of a step, with the loss's SSIM and without."""
    n, size = text.split(":")
    n, (width, height) = int(n), map(int, size.split("x"))
    means, scales, quats, logits, harmonics = parameters = ball(torch, n, device)
    eye = torch.tensor([2.5, 0.4, 0.3], device=device)
    unit = torch.nn.functional.normalize
    forward = unit(-eye, dim=0)
    right = unit(torch.linalg.cross(forward, torch.tensor([0.0, 0.0, 1.0], device=device)), dim=0)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
    view = torch.eye(4, device=device)
    view[:3, :3], view[:3, 3] = rotation, -rotation @ eye
    k = torch.tensor([[height, 0, width / 2], [0, height, height / 2], [0, 0, 1.0]], device=device)

    def render():
        return gsplat.rasterization(means, quats, scales.exp(), logits.sigmoid(), harmonics, view[None], k[None],
                                    width, height, sh_degree=3, packed=False)[0][0]

    with torch.no_grad():
        target = render().clamp(0, 1)
    adam = torch.optim.Adam(parameters, lr=1e-9, fused=device == "cuda")
    distance = ssim(torch, device)

    def step(structure):
        adam.zero_grad()
        picture = render()
        loss = (picture - target).abs().mean()
        (0.8 * loss + 0.2 * distance(picture, target) if structure else loss).backward()
        adam.step()

    def picture():
        with torch.no_grad():
            render()

    clock = Clock(torch, device)
    out = {"gaussians": n, "size": [width, height], "forward_ms": clock.median(picture, repeat),
           "step_ms": clock.median(lambda: step(True), repeat),
           "step_without_ssim_ms": clock.median(lambda: step(False), repeat)}
    if device == "cuda":
        out["memory_mib"] = torch.cuda.max_memory_allocated() / 2**20
    return out


def views_of(torch, folder, device):
    with open(os.path.join(folder, "dataset.json")) as file:
        record = json.load(file)

    def array(name, kind):
        with open(os.path.join(folder, name), "rb") as file:
            return torch.frombuffer(bytearray(file.read()), dtype=kind).to(device)

    pixels = array("rgba.bin", torch.uint8)
    for view in record["views"]:
        width, height = view["size"]
        own = pixels[view["offset"]:view["offset"] + 4 * width * height]
        view["rgba"] = own.view(height, width, 4)
        pose = torch.eye(4)
        pose[:3, :3] = torch.tensor(view["rotation"]).view(3, 3)
        pose[:3, 3] = torch.tensor(view["translation"])
        (fx, fy), (cx, cy) = view["focal"], view["centre"]
        view["pose"] = pose.to(device)
        view["k"] = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]], device=device)
    first = [array(f"{name}.bin", torch.float32).view(-1, 3) for name in ("means", "scales", "colours")]
    return record, first


def first_parameters(torch, first, device):
    means, scales, colours = first
    n = len(means)
    quats = torch.zeros(n, 4, device=device)
    quats[:, 0] = 1
    tensors = {
        "means": means, "scales": scales.log(), "quats": quats, "opacities": torch.full((n,), -2.1972, device=device),
        "sh0": ((colours - 0.5) / 0.2820948)[:, None], "shN": torch.zeros(n, 15, 3, device=device),
    }
    return torch.nn.ParameterDict({k: torch.nn.Parameter(v.clone().contiguous()) for k, v in tensors.items()})


def train(torch, gsplat, folder, iterations, seconds, device):
    record, first = views_of(torch, folder, device)
    parameters = first_parameters(torch, first, device)
    rates = {"means": 1.6e-4, "scales": 5e-3, "quats": 1e-3, "opacities": 5e-2, "sh0": 2.5e-3, "shN": 1.25e-4}
    optimisers = {k: torch.optim.Adam([{"params": parameters[k], "lr": rates[k], "name": k}], eps=1e-15,
                                      fused=device == "cuda") for k in rates}
    strategy = gsplat.DefaultStrategy(refine_stop_iter=iterations // 2)
    strategy.check_sanity(parameters, optimisers)
    state = strategy.initialize_state(scene_scale=1.0)
    transparent, distance = record["transparent"], ssim(torch, device)
    training = [v for v in record["views"] if not v["held_out"]]

    def render(view, degree, background):
        harmonics = torch.cat([parameters["sh0"], parameters["shN"]], dim=1)
        width, height = view["size"]
        return gsplat.rasterization(parameters["means"], parameters["quats"], parameters["scales"].exp(),
                                    parameters["opacities"].sigmoid(), harmonics, view["pose"][None], view["k"][None],
                                    width, height, sh_degree=degree, packed=False, backgrounds=background[None])

    def photo(view, background):
        rgba = view["rgba"].float() / 255
        rgb, alpha = rgba[..., :3], rgba[..., 3:]
        return rgb * alpha + (1 - alpha) * background if transparent else rgb

    def score():
        total, count, black = 0.0, 0, torch.zeros(3, device=device)
        with torch.no_grad():
            for view in record["views"]:
                if view["held_out"]:
                    picture = (render(view, 3, black)[0][0].clamp(0, 1) * 255).round() / 255
                    error = (picture - (photo(view, black) * 255).round() / 255).square().mean().item()
                    total, count = total - 10 * math.log10(max(error, 1e-12)), count + 1
        return total / max(count, 1)

    clock, spent, curve = Clock(torch, device), 0.0, []
    torch.manual_seed(0)
    order = []
    begun = clock.now()
    for step in range(iterations):
        order = order or torch.randperm(len(training)).tolist()
        view = training[order.pop()]
        optimisers["means"].param_groups[0]["lr"] = rates["means"] * 0.01 ** (step / iterations)
        background = torch.rand(3, device=device) if transparent else torch.zeros(3, device=device)
        pictures, _, info = render(view, min(3, step // 1000), background)
        strategy.step_pre_backward(parameters, optimisers, state, step, info)
        target = photo(view, background)
        loss = 0.8 * (pictures[0] - target).abs().mean() + 0.2 * distance(pictures[0], target)
        loss.backward()
        for optimiser in optimisers.values():
            optimiser.step()
            optimiser.zero_grad(set_to_none=True)
        strategy.step_post_backward(parameters, optimisers, state, step, info, packed=False)
        if step + 1 in SIDES or step + 1 == iterations:
            spent += clock.now() - begun
            curve.append({"iteration": step + 1, "seconds": spent / 1e3, "psnr_held_out": score(),
                          "gaussians": len(parameters["means"])})
            if spent / 1e3 > seconds:
                break
            begun = clock.now()
    view = next(v for v in record["views"] if v["held_out"])

    def picture():
        with torch.no_grad():
            render(view, 3, torch.zeros(3, device=device))

    out = {"name": os.path.basename(os.path.normpath(folder)), "curve": curve, "picture_ms": clock.median(picture, 20)}
    if device == "cuda":
        out["memory_mib"] = torch.cuda.max_memory_allocated() / 2**20
    return out


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="*", default=[])
    parser.add_argument("--data", nargs="*", default=[])
    parser.add_argument("--iterations", type=int, default=7000)
    parser.add_argument("--seconds", type=float, default=60, help="of training on each data set, about")
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("--device", default="cuda")
    args = parser.parse_args()
    try:
        torch, gsplat = load()
        if args.device == "cuda" and not torch.cuda.is_available():
            raise RuntimeError("torch finds no card")
    except (ImportError, RuntimeError, OSError) as error:
        print(json.dumps({"missing": str(error)}))
        return
    out = {"version": gsplat.__version__, "torch": torch.__version__, "synthetic": [], "datasets": []}
    jobs = [(out["synthetic"], lambda s=s: scene(torch, gsplat, s, args.repeat, args.device), s) for s in args.scene]
    jobs += [(out["datasets"],
              lambda d=d: train(torch, gsplat, d, args.iterations, args.seconds, args.device), d) for d in args.data]
    for results, job, name in jobs:
        try:
            if args.device == "cuda":
                torch.cuda.empty_cache()
                torch.cuda.reset_peak_memory_stats()
            results.append(job())
        except Exception as error:  # out of memory, a kernel that does not compile: the others still count
            results.append({"name": name, "error": f"{type(error).__name__}: {error}"[:300]})
    print(json.dumps(out))


if __name__ == "__main__":
    main()
