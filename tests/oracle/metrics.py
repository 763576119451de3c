#!/usr/bin/env python3
"""PSNR and SSIM of formula-made images by scikit-image: scene/tests/fixtures/metrics.json.

The Rust test (scene/tests/metrics.rs) makes the same images from the same integer formulas.
Needs numpy and scikit-image.
"""

import json
import os

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

OUT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../scene/tests/fixtures/metrics.json")


def pattern(width, height, kind):
    """Pair of uint8 images of a case."""
    y, x, c = np.mgrid[0:height, 0:width, 0:3].astype(np.int64)
    hashed = ((x * 73856093) ^ (y * 19349663) ^ (c * 83492791)) % 65521
    a = (x * 3 + y * 5 + c * 40 + (x * y) // 7) % 256
    if kind == "noise":
        b = np.clip(a + hashed % 21 - 10, 0, 255)
    elif kind == "shift":
        b = ((x + 1) * 3 + y * 5 + c * 40 + ((x + 1) * y) // 7) % 256
    elif kind == "dark":
        a = a // 16
        b = np.clip(a + hashed % 5 - 2, 0, 255)
    else:  # unrelated
        b = hashed % 256
    return a.astype(np.uint8), b.astype(np.uint8)


def ssim(a, b):
    """Mean and map, values in [0, 1]."""
    return structural_similarity(a / 255.0, b / 255.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
                                 data_range=1.0, channel_axis=-1, full=True)


def main():
    cases = []
    for width, height, kind in [(64, 48, "noise"), (200, 37, "shift"), (11, 11, "noise"), (97, 80, "dark"),
                                (150, 150, "unrelated")]:
        a, b = pattern(width, height, kind)
        mean, full = ssim(a, b)
        y, x = np.mgrid[0:height, 0:width]
        mask = (x - width / 2) ** 2 + (y - height / 2) ** 2 < (min(width, height) / 3) ** 2
        inside = mask.copy()
        inside[:5] = inside[-5:] = False
        inside[:, :5] = inside[:, -5:] = False
        mse = np.mean((a[mask] / 255.0 - b[mask] / 255.0) ** 2)
        cases.append({
            "width": width, "height": height, "kind": kind,
            "psnr": float(peak_signal_noise_ratio(a / 255.0, b / 255.0, data_range=1.0)), "ssim": float(mean),
            "psnr_masked": float(-10 * np.log10(mse)), "ssim_masked": float(full[inside].mean()),
        })
    with open(OUT, "w") as f:
        json.dump(cases, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
