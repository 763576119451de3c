"""Photos as files: PNG without a library, and what is done to photos of good sets."""
import os
import shutil
import struct
import zlib

import numpy as np

WRONG = {}


def wrong(function):
    WRONG[function.__name__] = function
    return function


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path, pixels):
    """[H, W] or [H, W, 1-4 channels], uint8 or uint16."""
    pixels = np.asarray(pixels)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    height, width, channels = pixels.shape
    depth = 16 if pixels.dtype == np.uint16 else 8
    rows = pixels.astype(">u2" if depth == 16 else np.uint8).reshape(height, -1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    header = struct.pack(">IIBBBBB", width, height, depth, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def noise(rng, height, width):
    return np.random.default_rng(rng.randrange(1 << 30)).integers(0, 256, (height, width, 3), np.uint8)


def two(folder, rng):
    return [os.path.join(folder, n) for n in rng.sample(sorted(os.listdir(folder)), 2)]


@wrong
def photo_is_noise(folder, rng):
    write_png(two(folder, rng)[0], noise(rng, 180, 240))


@wrong
def photo_is_black(folder, rng):
    write_png(two(folder, rng)[0], np.zeros((180, 240, 3), np.uint8))


@wrong
def photo_is_empty(folder, rng):
    open(two(folder, rng)[0], "wb").close()


@wrong
def photo_is_cut_off(folder, rng):
    path = two(folder, rng)[0]
    os.truncate(path, int(os.path.getsize(path) * rng.uniform(0.05, 0.9)))


@wrong
def photo_is_missing(folder, rng):
    os.remove(two(folder, rng)[0])


@wrong
def photo_is_another(folder, rng):
    a, b = two(folder, rng)
    shutil.copy(a, b)


@wrong
def photos_are_exchanged(folder, rng):
    a, b = two(folder, rng)
    os.rename(a, a + ".tmp")
    os.rename(b, a)
    os.rename(a + ".tmp", b)


@wrong
def photos_are_shifted_by_one(folder, rng):
    paths = [os.path.join(folder, n) for n in sorted(os.listdir(folder))]
    os.rename(paths[0], paths[0] + ".tmp")
    for a, b in zip(paths[1:], paths):
        os.rename(a, b)
    os.rename(paths[0] + ".tmp", paths[-1])


@wrong
def photo_has_another_size(folder, rng):
    write_png(two(folder, rng)[0], noise(rng, *rng.choice([(1, 1), (90, 120), (240, 180), (1, 240), (360, 480)])))
