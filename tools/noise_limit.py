#!/usr/bin/env python3
"""How alike two pictures of the same still can be at best, for the noise in them: PSNR and SSIM of
the expected pictures against the filmed ones.

    noise_limit.py FILMED EXPECTED [--every 8]

FILMED: the images/ of a still case of the test bed. EXPECTED: those of `develop.py CASE RENDERS
FOLDER --takes 16`, the mean of other draws of the noise, which no rendering can come closer than in
squared error. Every 8th picture from the first is compared, as held-out views are. SSIM as
elsewhere here: Gaussian window of 11 pixels, sigma 1.5, where it fits into the picture, mean over
the channels (Wang et al. 2004).
"""
import argparse
import os

import numpy as np
from PIL import Image
from scipy.ndimage import correlate1d

WINDOW = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
WINDOW /= WINDOW.sum()


def smooth(x):
    return correlate1d(correlate1d(x, WINDOW, axis=0), WINDOW, axis=1)[5:-5, 5:-5]


def ssim(a, b):
    """Mean structural similarity of two pictures of bytes, height x width x 3."""
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    ma, mb = smooth(a), smooth(b)
    va, vb, cov = smooth(a * a) - ma * ma, smooth(b * b) - mb * mb, smooth(a * b) - ma * mb
    return np.mean((2 * ma * mb + c1) * (2 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2)))


def psnr(a, b):
    return 10 * np.log10(255**2 / np.mean((a - b) ** 2))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("filmed")
    parser.add_argument("expected")
    parser.add_argument("--every", type=int, default=8)
    args = parser.parse_args()

    def load(folder, name):
        return np.asarray(Image.open(os.path.join(folder, name)).convert("RGB"), float)

    pairs = list(zip(sorted(os.listdir(args.filmed)), sorted(os.listdir(args.expected))))[:: args.every]
    for a, b in pairs:
        if os.path.splitext(a)[0] != os.path.splitext(b)[0]:
            raise SystemExit(f"{a} and {b} are not the same still")
    scores = [[f(load(args.filmed, a), load(args.expected, b)) for f in (psnr, ssim)] for a, b in pairs]
    print("%d stills: PSNR %.2f dB, SSIM %.4f" % (len(scores), *np.mean(scores, axis=0)))


if __name__ == "__main__":
    main()
