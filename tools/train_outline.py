"""Trains the network that solves the key's outline once more
(preprocess/src/matting/refine_network.rs). Needs numpy.

    target/release/examples/outline_samples SAMPLES FOLDER...       (again for more files)
    python3 tools/train_outline.py WEIGHTS SAMPLES... [--test SAMPLES...] [--epochs 22] [--most 9000000]

Rows of samples are inputs, alpha of the key, true alpha (little-endian f32). Two hidden layers of
rectified units; the network's output is added to the logit of the key's alpha. Cross entropy
against the true alpha, AdamW (Loshchilov & Hutter 2019), one cycle of the step. Inputs x are taken
as (x - mean) scale, at most 4 either way. WEIGHTS: mean, scale, W1 [inputs, 96], b1, W2 [96, 32],
b2, w3 [32], b3, little-endian f32. Ten million rows take 9 GB of memory and some 35 seconds an
epoch.
"""

import argparse

import numpy as np

HIDDEN = (96, 32)
INPUTS = 201
BATCH = 4096
FARTHEST = 4


def rows(paths, most):
    """At most so many rows of each file."""
    rng = np.random.default_rng(0)
    files = [np.memmap(path, "<f4", "r").reshape(-1, INPUTS + 2) for path in paths]
    counts = [min(len(a), most) for a in files]
    data = np.empty((sum(counts), INPUTS + 2), "f4")
    for a, count, end in zip(files, counts, np.cumsum(counts)):
        chosen = np.sort(rng.choice(len(a), count, False))
        for k in range(0, count, 1 << 18):
            data[end - count + k : end - count + min(k + (1 << 18), count)] = a[chosen[k : k + (1 << 18)]]
    return data


def logit(alpha):
    a = np.clip(alpha, 0.02, 0.98)
    return np.log(a / (1 - a))


def scaled(x, mean, scale):
    return np.clip((x - mean) * scale, -FARTHEST, FARTHEST)


def forward(parameters, x):
    """Values of all layers; the last is what is added to the logit."""
    layers = [x]
    for k in range(0, len(parameters), 2):
        z = layers[-1] @ parameters[k] + parameters[k + 1]
        layers.append(np.maximum(z, 0) if k + 2 < len(parameters) else z)
    return layers


def gradients(parameters, layers, d):
    out = []
    for k in range(len(parameters) - 2, -1, -2):
        x = layers[k // 2]
        out += [d.sum(0), x.T @ d]
        if k:
            d = (d @ parameters[k].T) * (x > 0)
    return out[::-1]


def train(data, epochs, step=4e-3, decay=1e-2):
    rng = np.random.default_rng(1)
    some = data[rng.permutation(len(data))[:300_000], :INPUTS].astype("f8")
    mean, scale = some.mean(0).astype("f4"), (1 / (some.std(0) + 1e-2)).astype("f4")
    sizes = (INPUTS, *HIDDEN, 1)
    parameters = []
    for a, b in zip(sizes, sizes[1:]):
        width = 0 if b == 1 else np.sqrt(2 / a)
        parameters += [(width * rng.standard_normal((a, b))).astype("f4"), np.zeros(b, "f4")]
    first, second = [np.zeros_like(p) for p in parameters], [np.zeros_like(p) for p in parameters]
    batches = len(data) // BATCH
    total, t = epochs * batches, 0
    for epoch in range(epochs):
        order, loss = rng.permutation(len(data)), 0.0
        for k in range(batches):
            part = data[order[k * BATCH : (k + 1) * BATCH]]
            layers = forward(parameters, scaled(part[:, :INPUTS], mean, scale))
            p = 1 / (1 + np.exp(-(layers[-1][:, 0] + logit(part[:, INPUTS]))))
            truth = part[:, INPUTS + 1]
            loss += np.abs(p - truth).mean()
            t += 1
            share = t / total
            rate = step * (share / 0.3 if share < 0.3 else 0.5 * (1 + np.cos(np.pi * (share - 0.3) / 0.7)))
            for q, g, m, v in zip(parameters, gradients(parameters, layers, ((p - truth) / BATCH)[:, None].astype("f4")), first, second):
                m += 0.1 * (g - m)
                v += 0.001 * (g * g - v)
                q -= rate * (m / (1 - 0.9**t) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8) + decay * q)
        print(f"epoch {epoch + 1}: mean error of alpha {loss / batches:.4f}", flush=True)
    return [np.ascontiguousarray(p, "<f4") for p in (mean, scale, *parameters)]


def report(parameters, path):
    """Pixels on the wrong side of a half and mean error of alpha, before and after."""
    data = rows([path], 10**9)
    parts = [data[i : i + 65536] for i in range(0, len(data), 65536)]
    z = np.concatenate([forward(parameters[2:], scaled(p[:, :INPUTS], *parameters[:2]))[-1][:, 0] for p in parts]) + logit(data[:, INPUTS])
    after, before, truth = 1 / (1 + np.exp(-z)), data[:, INPUTS], data[:, INPUTS + 1]
    wrong = [1e3 * ((a >= 0.5) != (truth >= 0.5)).mean() for a in (before, after)]
    error = [np.abs(a - truth).mean() for a in (before, after)]
    print(f"{path}: wrong {wrong[0]:.0f} -> {wrong[1]:.0f} of 1,000, error {error[0]:.3f} -> {error[1]:.3f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("samples", nargs="+")
    parser.add_argument("--test", nargs="*", default=[])
    parser.add_argument("--epochs", type=int, default=22)
    parser.add_argument("--most", type=int, default=9_000_000, help="rows of each file")
    options = parser.parse_args()
    data = rows(options.samples, options.most)
    print(f"{len(data)} rows")
    parameters = train(data, options.epochs)
    with open(options.weights, "wb") as out:
        for p in parameters:
            out.write(p.tobytes())
    for path in options.test:
        report(parameters, path)


if __name__ == "__main__":
    main()
