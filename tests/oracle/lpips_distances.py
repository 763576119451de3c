#!/usr/bin/env python3
"""LPIPS of formula-made images by the `lpips` package: scene/tests/fixtures/lpips.json.

Weights cannot be shipped, so both sides fill the networks with the same numbers from an integer
formula; the Rust test (scene/tests/lpips.rs) does the same. Needs numpy, torch, torchvision and
lpips.
"""

import json
import os

import lpips
import numpy as np
import torch

from metrics import pattern

OUT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../scene/tests/fixtures/lpips.json")
CONVOLUTIONS = {"alex": [0, 3, 6, 8, 10], "vgg": [0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28]}


def formula(seed, shape):
    """Uniform numbers: weights in ± sqrt(6 / fan-in), biases in ± 0.1, linear layers in [0, 1]."""
    count = int(np.prod(shape))
    h = (np.arange(count, dtype=np.uint64) * 2654435761 + seed * 40503 + 12345) & 0xFFFFFFFF
    h = ((h ^ (h >> np.uint64(16))) * 2246822519) & 0xFFFFFFFF
    h = h ^ (h >> np.uint64(13))
    unit = (h % 65536).astype(np.float32) / np.float32(32768) - np.float32(1)
    if shape[0] == 1:
        unit = (unit + np.float32(1)) / np.float32(2)
    elif len(shape) == 4:
        unit = unit * np.float32(np.sqrt(6 / np.prod(shape[1:])))
    else:
        unit = unit * np.float32(0.1)
    return torch.from_numpy(unit.reshape(shape))


def network(name):
    model = lpips.LPIPS(net=name, pretrained=False, pnet_rand=True, verbose=False).eval()
    layers = {key.split(".", 1)[1]: value for key, value in model.net.state_dict().items()}  # sliceN.INDEX.weight
    with torch.no_grad():
        for i, index in enumerate(CONVOLUTIONS[name]):
            for j, kind in enumerate(["weight", "bias"]):
                target = layers[f"{index}.{kind}"]
                target.copy_(formula(2 * i + j, tuple(target.shape)))
        for i, lin in enumerate(model.lins):
            weight = lin.model[1].weight
            weight.copy_(formula(100 + i, tuple(weight.shape)))
    return model


def main():
    cases = []
    for name in CONVOLUTIONS:
        model = network(name)
        for width, height, kind in [(64, 64, "noise"), (97, 80, "unrelated"), (131, 75, "dark"), (64, 48, "shift")]:
            pair = [torch.from_numpy(p / 127.5 - 1).float().permute(2, 0, 1)[None] for p in pattern(width, height, kind)]
            with torch.no_grad():
                distance = float(model(*pair))
            cases.append({"net": name, "width": width, "height": height, "kind": kind, "distance": distance})
    with open(OUT, "w") as file:
        json.dump(cases, file, indent=1)
        file.write("\n")


main()
