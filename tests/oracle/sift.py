#!/usr/bin/env python3
"""Features of OpenCV and COLMAP for the table that `features_table` prints.

    sift.py DATA OUT        DATA: ../shared/data

Writes OUT/SET/{opencv,colmap}/IMAGE.bin: u32 count, count x (x, y, scale, angle) f32 (first pixel's centre at
0.5, 0.5), count x 128 bytes RootSIFT (512 sqrt(h / sum h)). Needs numpy, opencv-python-headless, pycolmap.
"""
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


def opencv(grey):
    """OpenCV's SIFT with its defaults; RootSIFT of its descriptors. Keypoint size is a diameter."""
    found, descriptors = cv2.SIFT_create().detectAndCompute(grey, None)
    keypoints = [(k.pt[0] + 0.5, k.pt[1] + 0.5, k.size / 2, np.radians(k.angle)) for k in found]
    d = np.zeros((0, 128)) if descriptors is None else descriptors
    d = np.sqrt(d / np.maximum(d.sum(axis=1, keepdims=True), 1e-9))
    return np.reshape(keypoints, (-1, 4)), np.clip(np.rint(512 * d), 0, 255)


def colmap(grey):
    """COLMAP's SIFT with its defaults."""
    options = pycolmap.FeatureExtractionOptions()
    extractor = pycolmap.Sift(options=options, device=pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract(np.ascontiguousarray(grey))
    d = np.asarray(descriptors, np.float32)
    return np.asarray(keypoints)[:, :4], np.clip(np.rint(512 * d if d.max(initial=0) <= 1.001 else d), 0, 255)


def main():
    data, out = sys.argv[1:3]
    for name in ("temple_ring", "fountain_p11"):
        for path in sorted(glob.glob(os.path.join(data, name, "images", "*"))):
            rgb = cv2.imread(path)
            grey = cv2.cvtColor(rgb, cv2.COLOR_BGR2GRAY)
            for who in (opencv, colmap):
                folder = os.path.join(out, name, who.__name__)
                os.makedirs(folder, exist_ok=True)
                write(os.path.join(folder, os.path.basename(path) + ".bin"), *who(grey))


if __name__ == "__main__":
    main()
