#!/usr/bin/env python3
"""Features of OpenCV and COLMAP for the table that `features_table` prints.

    sift.py DATA OUT        DATA: ../shared/data

Writes OUT/SET/{opencv,colmap}/IMAGE.bin: u32 count, count x (x, y, scale, angle) f32 (first pixel's
centre at 0.5, 0.5), count x 128 bytes RootSIFT (512 sqrt(h / sum h)). And
OUT/homography/SET_CHANGE/: a photo (a.png), the same moved by a known homography (b.png; h.txt, b
from a), and their features. Needs numpy, opencv-python-headless, pycolmap.
"""
import functools
import glob
import os
import sys

import cv2
import numpy as np
import pycolmap


def write(path, keypoints, descriptors):
    with open(path, "wb") as f:
        f.write(np.uint32(len(keypoints)).tobytes())
        f.write(np.ascontiguousarray(keypoints, np.float32).tobytes())
        f.write(np.ascontiguousarray(descriptors, np.uint8).tobytes())


def opencv(path):
    """OpenCV's SIFT with its defaults; RootSIFT of its descriptors. Keypoint size is a diameter."""
    grey = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    found, descriptors = cv2.SIFT_create().detectAndCompute(grey, None)
    keypoints = [(k.pt[0] + 0.5, k.pt[1] + 0.5, k.size / 2, np.radians(k.angle)) for k in found]
    d = np.zeros((0, 128)) if descriptors is None else descriptors
    d = np.sqrt(d / np.maximum(d.sum(axis=1, keepdims=True), 1e-9))
    return np.reshape(keypoints, (-1, 4)), np.clip(np.rint(512 * d), 0, 255)


@functools.cache
def extractor():
    return pycolmap.FeatureExtractor.create(pycolmap.FeatureExtractionOptions(num_threads=1, use_gpu=False))


def colmap(path):
    """COLMAP's SIFT with its defaults."""
    found, descriptors = extractor().extract(pycolmap.Bitmap.read(path, False))
    keypoints = [(k.x, k.y, k.compute_scale(), k.compute_orientation()) for k in found]
    return np.reshape(keypoints, (-1, 4)), descriptors.data


def turned(w, h, degrees, scale):
    """About the image centre, with the first pixel's centre at 0.5, 0.5."""
    c, s = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    x, y = w / 2, h / 2
    return np.array([[c, -s, x - c * x + s * y], [s, c, y - s * x - c * y], [0, 0, 1]])


def slanted(w, h):
    corners = np.float32([[0, 0], [w, 0], [w, h], [0, h]])
    moved = corners + np.float32([[0.18 * w, 0.05 * h], [-0.02 * w, 0.12 * h], [-0.1 * w, -0.1 * h], [0.03 * w, 0]])
    return cv2.getPerspectiveTransform(corners, moved)


# Motion of the picture, then its gain and the standard deviation of noise.
CHANGES = {
    "turned_30": (lambda w, h: turned(w, h, 30, 1), 1, 0),
    "scaled_0.6": (lambda w, h: turned(w, h, 0, 0.6), 1, 0),
    "slanted": (slanted, 1, 0),
    "dark_0.15_noise_2": (lambda w, h: turned(w, h, 5, 1), 0.15, 2),
}


def homographies(data, out):
    random = np.random.default_rng(1)
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV warps with the first pixel's centre at 0, 0
    for name, photo in (("temple_ring", "templeR0001.png"), ("fountain_p11", "0003.jpg")):
        grey = cv2.imread(os.path.join(data, name, "images", photo), cv2.IMREAD_GRAYSCALE)
        height, width = grey.shape
        for change, (motion, gain, noise) in CHANGES.items():
            h = motion(width, height)
            moved = cv2.warpPerspective(grey, np.linalg.inv(half) @ h @ half, (width, height), flags=cv2.INTER_AREA)
            noisy = gain * moved + random.normal(0, noise, moved.shape) if noise else gain * moved
            folder = os.path.join(out, "homography", f"{name}_{change}")
            os.makedirs(folder, exist_ok=True)
            np.savetxt(os.path.join(folder, "h.txt"), h)
            for side, picture in (("a", grey), ("b", np.clip(np.rint(noisy), 0, 255).astype(np.uint8))):
                path = os.path.join(folder, side + ".png")
                cv2.imwrite(path, picture)
                for who in (opencv, colmap):
                    os.makedirs(os.path.join(folder, who.__name__), exist_ok=True)
                    write(os.path.join(folder, who.__name__, side + ".png.bin"), *who(path))


def main():
    data, out = sys.argv[1:3]
    homographies(data, out)
    for name in ("temple_ring", "fountain_p11"):
        for path in sorted(glob.glob(os.path.join(data, name, "images", "*"))):
            for who in (opencv, colmap):
                folder = os.path.join(out, name, who.__name__)
                os.makedirs(folder, exist_ok=True)
                write(os.path.join(folder, os.path.basename(path) + ".bin"), *who(path))


if __name__ == "__main__":
    main()
