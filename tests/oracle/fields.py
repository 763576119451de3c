#!/usr/bin/env python3
"""Twins of the radiance fields in torch: baselines/tests/fixtures/*.json.

Weights, rays and samples are the same integer formula on both sides, so that the Rust tests
(`twin.rs` of each method) need no file but these results: colours, losses, gradients by torch's own
differentiation, and the losses of 200 steps of training. All in f64. Needs numpy and torch.

With --table the tests are run (cargo; or --table FILE: what they printed is read) and what they
deviate by is written to docs/results/fields.json.
"""

import json
import math
import os
import subprocess
import sys

import numpy as np
import torch

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../..")
OUT = os.path.join(ROOT, "baselines/tests/fixtures")
STEPS = 200
# At the rates of the end of a schedule: at those of its beginning torch in f32 leaves torch in f64 too.
NGP_RATE, NERF_RATE = 1e-2 * 0.33**3, 5e-5
torch.set_default_dtype(torch.float64)
torch.set_num_threads(1)  # the tensors are small


def formula(seed, *shape):
    """Uniform numbers in [-1, 1), multiples of 1/32768."""
    count = int(np.prod(shape))
    h = (np.arange(count, dtype=np.uint64) * 2654435761 + seed * 40503 + 12345) & 0xFFFFFFFF
    h = ((h ^ (h >> np.uint64(16))) * 2246822519) & 0xFFFFFFFF
    h = h ^ (h >> np.uint64(13))
    return ((h % 65536).astype(np.float32) / np.float32(32768) - np.float32(1)).reshape(shape)


def tensor(values):
    return torch.from_numpy(np.asarray(values, np.float64))


def leaf(values):
    return tensor(values).requires_grad_(True)


def scaled(seed, shape, bound):
    return leaf(formula(seed, *shape) * np.float32(bound))


def directions(seed, count):
    d = formula(seed, count, 3).astype(np.float64)
    return tensor(d / np.linalg.norm(d, axis=1, keepdims=True))


class Adam:
    """Kingma and Ba 2015; `sparse` moves only what has a gradient."""

    def __init__(self, leaves, betas, epsilon, decay=0.0, sparse=False):
        self.leaves, self.epsilon, self.decay, self.sparse = leaves, epsilon, decay, sparse
        self.betas = [float(np.float32(b)) for b in betas]
        self.moments = [(torch.zeros_like(x), torch.zeros_like(x)) for x in leaves]

    def step(self, rate, number):
        b1, b2 = self.betas
        rate *= math.sqrt(1 - b2**number) / (1 - b1**number)
        with torch.no_grad():
            for x, (m, v) in zip(self.leaves, self.moments):
                g = x.grad if x.grad is not None else torch.zeros_like(x)
                g = g + self.decay * x
                on = g != 0 if self.sparse else torch.ones_like(g, dtype=torch.bool)
                m[on] = b1 * m[on] + (1 - b1) * g[on]
                v[on] = b2 * v[on] + (1 - b2) * g[on] ** 2
                x[on] -= rate * m[on] / (v[on].sqrt() + self.epsilon)
                x.grad = None


def compose(density, dt, rgb, background, keep=None):
    """Colours of rays; arrays [rays, samples], what `keep` leaves out shows nothing."""
    alpha = 1 - torch.exp(-density * dt)
    if keep is not None:
        alpha = alpha * keep
    through = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha], 1), 1)
    weight = through[:, :-1] * alpha
    return (weight[..., None] * rgb).sum(1) + through[:, -1:] * background, weight, through[:, :-1]


def sampled(gradient, left_out=(), count=96):
    """Values at some places, and the largest of all; none of the rows that are left out."""
    flat = gradient.reshape(-1)
    places = np.unique(np.linspace(0, flat.numel() - 1, count // 2).astype(int))
    largest = torch.argsort(flat.abs(), descending=True)[: count // 2].numpy()
    places = np.unique(np.concatenate([places, largest]))
    places = places[~np.isin(places // gradient.shape[-1], left_out)]
    return {"places": places.tolist(), "values": flat[places].tolist(), "largest": float(flat.abs().max())}


def record(name, forward, loss, leaves, curve, left_out={}):
    out = {"forward": forward.reshape(-1).tolist(), "loss": float(loss.detach()), "curve": curve,
           "gradients": {key: sampled(x.grad, left_out.get(key, ())) for key, x in leaves.items()}}
    with open(os.path.join(OUT, f"{name}.json"), "w") as file:
        json.dump(out, file)
        file.write("\n")
    print(name, "loss", float(loss.detach()), "curve", curve[0], "to", curve[-1])


# Instant NeRF ------------------------------------------------------------------------------------

LEVELS, ENTRIES, RAYS, MOST = 4, 1 << 13, 48, 12


def harmonics(d):
    x, y, z = d.unbind(-1)
    c1, c2, c2z, c2d = 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
    c3 = [0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277]
    one = torch.ones_like(x)
    return torch.stack([
        0.28209479177387814 * one, -c1 * y, c1 * z, -c1 * x,
        c2 * x * y, -c2 * y * z, c2z * (2 * z * z - x * x - y * y), -c2 * x * z, c2d * (x * x - y * y),
        -c3[0] * y * (3 * x * x - y * y), c3[1] * x * y * z, -c3[2] * y * (4 * z * z - x * x - y * y),
        c3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y), -c3[2] * x * (4 * z * z - x * x - y * y),
        c3[4] * z * (x * x - y * y), -c3[0] * x * (x * x - 3 * y * y)], -1)


def hash_features(tables, p):
    out = []
    for level, table in enumerate(tables):
        scale = float(np.float32(16 * 128 ** (level / (LEVELS - 1)) - 1))
        side = math.ceil(16 * 128 ** (level / (LEVELS - 1)) - 1) + 2
        x = p * scale + 0.5
        low = torch.floor(x)
        f, low = x - low, low.long()
        total = 0
        for corner in range(8):
            bits = torch.tensor([corner >> a & 1 for a in range(3)])
            at = low + bits
            share = torch.where(bits == 1, f, 1 - f).prod(-1)
            if side**3 <= ENTRIES:
                index = at[..., 0] + side * (at[..., 1] + side * at[..., 2])
            else:
                primes = [1, 2654435761, 805459861]
                mixed = [(at[..., a] * primes[a]) & 0xFFFFFFFF for a in range(3)]
                index = (mixed[0] ^ mixed[1] ^ mixed[2]) % ENTRIES
            total = total + share[..., None] * table[index]
        out.append(total)
    return torch.cat(out, -1)


def perceptron(layers, x):
    for index, w in enumerate(layers):
        x = x @ w
        if index + 1 < len(layers):
            x = torch.relu(x)
    return x


def instant_ngp():
    tables = []
    for level in range(LEVELS):
        side = math.ceil(16 * 128 ** (level / (LEVELS - 1)) - 1) + 2
        tables.append(leaf(formula(100 + level, side**3 if side**3 <= ENTRIES else ENTRIES, 4)))
    widths = [[16, 64, 16], [32, 64, 64, 16]]
    networks = [[scaled(10 + 8 * n + k, (a, b), np.sqrt(np.float32(6 / (a + b)))) for k, (a, b) in
                 enumerate(zip(w, w[1:]))] for n, w in enumerate(widths)]

    def batch(step):
        d = directions(1000 + step, RAYS)
        background = tensor(formula(2000 + step, RAYS, 3)) * 0.5 + 0.5
        p = np.floor((formula(3000 + step, RAYS, MOST, 3) * 0.5 + 0.5) * 1024) / 1024
        counts = torch.arange(RAYS) % (MOST + 1)
        keep = (torch.arange(MOST)[None] < counts[:, None]).double()
        features = hash_features(tables, tensor(p))
        latent = perceptron(networks[0], features)
        inputs = torch.cat([latent, harmonics(d)[:, None].expand(-1, MOST, -1)], -1)
        rgb = torch.sigmoid(perceptron(networks[1], inputs)[..., :3])
        density = torch.exp(latent[..., 0])
        _, _, through = compose(density.detach(), 0.1, rgb.detach(), background, keep)
        shown, _, _ = compose(density, 0.1, rgb, background, keep * (through >= 1e-4))
        e = (shown - (0.5 + 0.4 * torch.sin(3 * d))).abs()
        return shown, torch.where(e < 0.1, 0.5 * e * e, 0.1 * (e - 0.05)).mean()

    shown, loss = batch(0)
    loss.backward()
    names = {f"density{k}": w for k, w in enumerate(networks[0])} | {f"colour{k}": w for k, w in enumerate(networks[1])}
    names |= {f"table{k}": t for k, t in enumerate(tables)}
    kept = {key: torch.clone(x.grad) for key, x in names.items()}
    dense = Adam(networks[0] + networks[1], [0.9, 0.99], 1e-15, decay=1e-6)
    sparse = Adam(tables, [0.9, 0.99], 1e-15, sparse=True)
    curve = []
    for step in range(STEPS):
        for x in names.values():
            x.grad = None
        _, each = batch(step)
        each.backward()
        curve.append(float(each.detach()))
        dense.step(NGP_RATE, step + 1)
        sparse.step(NGP_RATE, step + 1)
    for key, x in names.items():
        x.grad = kept[key]
    record("instant-ngp", shown.detach(), loss, names, curve)


# NeRF and D-NeRF ---------------------------------------------------------------------------------

WIDTH, COUNT, EACH = 32, 20, 8


def waves(x, octaves):
    out = [x]
    for k in range(octaves):
        angle = 2.0**k * math.pi * x
        out.append(torch.stack([torch.sin(angle), torch.cos(angle)], -1).flatten(-2))
    return torch.cat(out, -1)


def sizes(position, deformation):
    all_ = [(position, WIDTH)] + [(WIDTH + position if layer == 5 else WIDTH, WIDTH) for layer in range(1, 8)]
    return all_ + ([(WIDTH, 3)] if deformation else [(WIDTH, WIDTH + 1), (WIDTH + 27, WIDTH // 2), (WIDTH // 2, 3)])


def affine(seed, shapes):
    layers = []
    for k, (a, b) in enumerate(shapes):
        bound = np.float32(1.6) / np.sqrt(np.float32(a))
        layers.append((scaled(seed + 2 * k, (a, b), bound), scaled(seed + 2 * k + 1, (b,), bound)))
    return layers


def trunk(layers, x):
    first = x
    for k, (w, b) in enumerate(layers[:8]):
        x = torch.relu((torch.cat([x, first], -1) if k == 5 else x) @ w + b)
    return x


def radiance(layers, p, d):
    w, b = layers[8]
    latent = trunk(layers, waves(p, 10)) @ w + b
    hidden = torch.relu(torch.cat([latent[..., :WIDTH], waves(d, 4)], -1) @ layers[9][0] + layers[9][1])
    return torch.relu(latent[..., WIDTH]), torch.sigmoid(hidden @ layers[10][0] + layers[10][1])


def refine(depths, weights):
    """Eight more depths by the weights, evenly in their sum (Mildenhall et al. 2020, section 5.2)."""
    out = []
    for t, w in zip(depths.numpy(), weights.numpy()):
        middles, inner = 0.5 * (t[1:] + t[:-1]), w[1:-1] + 1e-5
        below = np.concatenate([[0], np.cumsum(inner)])
        wanted = (np.arange(EACH) + 0.5) / EACH * below[-1]
        out.append(np.sort(np.concatenate([t, np.interp(wanted, below, middles)])))
    return tensor(np.array(out))


def nerf(deformed):
    networks = [affine(200, sizes(63, False)), affine(300, sizes(84, True) if deformed else sizes(63, False))]
    if deformed:  # high octaves would show how f32 rounds the places that positions are moved to
        with torch.no_grad():
            networks[0][0][0][33:63] = 0
            networks[0][5][0][WIDTH + 33:WIDTH + 63] = 0

    def evaluate(which, step, depths):
        origin = np.floor(formula(4000 + step, COUNT, 2) * 512) / 1024
        d = directions(5000 + step, COUNT)
        p = torch.stack([*[tensor(origin[:, a])[:, None].expand_as(depths) for a in range(2)], depths - 3], -1)
        if deformed:
            t = torch.arange(COUNT) / COUNT
            rows = torch.cat([waves(p, 10), waves(t[:, None], 10)[:, None].expand(-1, p.shape[1], -1)], -1)
            moved = trunk(networks[1], rows) @ networks[1][8][0] + networks[1][8][1]
            p = p + moved * (t != 0)[:, None, None]
        density, rgb = radiance(networks[0 if deformed else which], p, d[:, None].expand(-1, p.shape[1], -1))
        dt = torch.cat([depths[:, 1:], torch.full_like(depths[:, :1], 4)], 1) - depths
        shown, weight, _ = compose(density, dt, rgb, torch.full((COUNT, 3), 0.25))
        x, y = tensor(origin).unbind(-1)
        truth = torch.stack([0.5 + 0.4 * torch.sin(3 * x + c + 2 * y) for c in range(3)], -1)
        return shown, weight, ((shown - truth) ** 2).mean()

    exact = tensor(np.sort(np.floor((formula(6000, COUNT, EACH) + 1) * 1024) / 1024 + 2, axis=1))
    shown, _, loss = evaluate(1, 0, exact)
    loss.backward()
    first, second = (0, 1) if deformed else (1, None)
    names = {f"w{k}": w for k, (w, _) in enumerate(networks[first])} | {f"b{k}": b for k, (_, b) in enumerate(networks[first])}
    if second is not None:
        names |= {f"v{k}": w for k, (w, _) in enumerate(networks[second])} | {f"c{k}": b for k, (_, b) in enumerate(networks[second])}
    kept = {key: torch.clone(x.grad) for key, x in names.items()}
    leaves = [x for network in networks for layer in network for x in layer]
    adam, curve = Adam(leaves, [0.9, 0.999], 1e-7), []
    even = (2 + 2 * (torch.arange(EACH) + 0.5) / EACH)[None].expand(COUNT, -1)
    for step in range(STEPS):
        for x in leaves:
            x.grad = None
        _, weight, coarse = evaluate(0, step, even)
        _, _, fine = evaluate(1, step, refine(even, weight.detach()))
        (coarse + fine).backward()
        curve.append(float((coarse + fine).detach()))
        adam.step(NERF_RATE, step + 1)
    for key, x in names.items():
        x.grad = kept[key]
    high = {"w0": range(33, 63), "w5": range(WIDTH + 33, WIDTH + 63)} if deformed else {}
    record("d-nerf" if deformed else "nerf", shown.detach(), loss, names, curve,
           {key: np.array(rows) for key, rows in high.items()})


# 4DGS --------------------------------------------------------------------------------------------

GAUSSIANS, MOVES, PAIRS = 30, 10, [(0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3)]


def moving():
    planes, shapes = [], []
    for level in range(2):
        for pair in PAIRS:
            size = [7 if a == 3 else 5 << level for a in pair]
            shapes.append((pair, size))
            planes.append(leaf(np.float32(0.7) + np.float32(0.5) * formula(400 + len(planes), size[1], size[0], 16)))
    shape = [(32, 64), (64, 192), (192, MOVES)]
    layers = [(scaled(500 + 2 * k, s, 0.3), scaled(501 + 2 * k, s[1:], 0.3)) for k, s in enumerate(shape)]
    rest = tensor(formula(600, MOVES, GAUSSIANS) * np.float32(0.4)).T
    centre = tensor(np.array([0.1, -0.2, 0.3], np.float32))

    def moved(time):
        place = torch.cat([rest[:, :3] - centre + 0.5, torch.full((GAUSSIANS, 1), time)], 1).clamp(0, 1)
        features = []
        for level in range(2):
            product = 1
            for (pair, size), plane in list(zip(shapes, planes))[6 * level:6 * level + 6]:
                x = torch.stack([place[:, a] * (s - 1) for a, s in zip(pair, size)], 1)
                low = torch.stack([torch.clamp(x[:, k].floor(), 0, size[k] - 2) for k in range(2)], 1)
                f, low = x - low, low.long()
                read = 0
                for right in range(2):
                    for up in range(2):
                        share = (f[:, 0] if right else 1 - f[:, 0]) * (f[:, 1] if up else 1 - f[:, 1])
                        read = read + share[:, None] * plane[low[:, 1] + up, low[:, 0] + right]
                product = product * read
            features.append(product)
        x = torch.cat(features, 1)
        for k, (w, b) in enumerate(layers):
            x = x @ w + b
            if k < 2:
                x = torch.relu(x)
        unit = torch.tensor([0.5] * 3 + [1.0] * (MOVES - 3))
        return rest + unit * x

    def loss(time):
        out = moved(time)
        target = rest + 0.3 * torch.sin(5 * time + torch.arange(MOVES))
        return out, ((out - target) ** 2).mean()

    def smoothness():
        total = 0
        for (pair, _), plane in zip(shapes, planes):
            share = 1 / plane.numel()
            if pair[1] == 3:
                total = total + share * (((plane[:-2] - 2 * plane[1:-1] + plane[2:]) ** 2).sum() + 1e-4 * (plane - 1).abs().sum())
            else:
                total = total + 2e-4 * share * (((plane[1:] - plane[:-1]) ** 2).sum() + ((plane[:, 1:] - plane[:, :-1]) ** 2).sum())
        return total

    out, first = loss(0.375)
    first.backward()
    names = {f"plane{k}": p for k, p in enumerate(planes)}
    names |= {f"w{k}": w for k, (w, _) in enumerate(layers)} | {f"b{k}": b for k, (_, b) in enumerate(layers)}
    kept = {key: torch.clone(x.grad) for key, x in names.items()}
    weights = [x for layer in layers for x in layer]
    grids, heads, curve = Adam(planes, [0.9, 0.999], 1e-15), Adam(weights, [0.9, 0.999], 1e-15), []
    times = formula(700, STEPS) * 0.5 + 0.5
    for step in range(STEPS):
        for x in names.values():
            x.grad = None
        _, each = loss(float(times[step]))
        (each + smoothness()).backward()
        curve.append(float(each.detach()))
        grids.step(1.6e-3, step + 1)
        heads.step(1.6e-4, step + 1)
    for key, x in names.items():
        x.grad = kept[key]
    record("4dgs", out.detach(), first, names, curve)


def write_table(printed):
    """Runs the tests that print deviations (or reads what they printed), and keeps the largest of each kind."""
    if len(printed) == 0:
        command = ["cargo", "test", "-p", "baselines", "--lib", "--locked", "--", "--nocapture", "twin_tests", "device_tests"]
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
        if run.returncode:
            sys.exit(run.stdout[-3000:] + run.stderr[-3000:])
        lines = run.stdout.splitlines()
    else:
        with open(printed[0]) as file:
            lines = file.read().splitlines()
    found = {}
    for words in map(str.split, lines):
        if words[:1] in (["twin"], ["parity"]):
            key = tuple(words[:3])
            found[key] = max(found.get(key, 0.0), float(words[-1]))
    subjects = {"twin": "processor, torch in f64", "parity": "adapter, processor"}
    rows = [[method, subject] + [f"{found[side, method, kind]:.1e}" for kind in ("forward", "gradient", "curve")]
            for side, subject in subjects.items() for method in ("instant-ngp", "nerf", "d-nerf", "4dgs")
            if (side, method, "forward") in found]
    sys.path.insert(0, os.path.join(ROOT, "tools"))
    import bench_results
    record = {"table": "fields", "version": bench_results.version(), "machine": bench_results.machine(),
              "columns": ["method", "compared", "forward, largest difference", "gradient, share of the largest",
                          "loss of 200 steps, means of 50"], "rows": rows}
    with open(os.path.join(ROOT, "docs/results/fields.json"), "w") as file:
        json.dump(record, file, indent=1)
        file.write("\n")


def main():
    if "--table" in sys.argv:
        return write_table(sys.argv[sys.argv.index("--table") + 1:])
    os.makedirs(OUT, exist_ok=True)
    instant_ngp()
    nerf(False)
    nerf(True)
    moving()


if __name__ == "__main__":
    main()
