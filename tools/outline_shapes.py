"""Films random shapes before a screen: what the key's outline is learnt from besides the test bed
(tools/train_outline.py).

    python3 tools/outline_shapes.py FOLDER FIRST LAST       scenes FIRST to LAST - 1, each a folder with video.mp4 and mattes/

Polygons, ellipses, rods, panels with slits, rings and lattices in foil, cells, stripes and plain
colours, lighter or darker towards their rims, some of which mirror the screen; a green or blue
screen with uneven light, folds and the shapes' shadow; lens and motion blur, photon and read noise,
H.264 4:2:0. Some scenes are cut-outs without a lens, sharp or with a rim that is mixed with black.
Needs numpy, scipy, pillow and ffmpeg.
"""

import argparse
import os
import subprocess

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import distance_transform_edt, gaussian_filter, uniform_filter1d, zoom
from scipy.spatial import cKDTree

WIDTH, HEIGHT, FINE = 640, 480, 3
FRAMES = 10


def log_uniform(rng, low, high):
    return np.exp(rng.uniform(np.log(low), np.log(high)))


def texture(rng, n=256):
    """Linear RGB [n, n, 3]."""
    kind = rng.choice(["plain", "foil", "cells", "stripes", "blotches"], p=[0.2, 0.3, 0.2, 0.1, 0.2])
    tint = np.ones(3) if rng.random() < 0.35 else np.clip(rng.random(3), 0.08, 1)
    x, y = np.meshgrid(np.arange(n), np.arange(n))
    light = np.ones((n, n))
    if kind == "foil":
        count = int(rng.integers(40, 600))
        facet = cKDTree(rng.random((count, 2)) * n).query(np.stack([x, y], -1).reshape(-1, 2))[1]
        light = np.exp(rng.normal(0, rng.uniform(0.2, 0.9), count))[facet].reshape(n, n)
    elif kind == "cells":
        pitch = int(rng.integers(6, 24))
        gap = (x % pitch < max(1, pitch // 8)) | (y % pitch < max(1, pitch // 8))
        light = np.where(gap, rng.uniform(0.4, 4), 1)
    elif kind == "stripes":
        light = np.where((x // int(rng.integers(6, 40))) % 2 == 0, 1, rng.uniform(0.15, 1))
    elif kind == "blotches":
        noise = [rng.uniform(0.1, 0.5) * zoom(rng.standard_normal((c, c)), n / c, order=1)[:n, :n] for c in (4, 16, 64)]
        light = np.exp(sum(noise))
    light = light * np.exp(rng.uniform(0, 0.15) * rng.standard_normal((n, n)))
    return log_uniform(rng, 0.015, 0.9) * light[..., None] * tint / tint.max()


def bar(a, b, half):
    along = (b - a) / np.linalg.norm(b - a)
    side = half * np.array([-along[1], along[0]])
    return np.array([a - side, b - side, b + side, a + side])


def outline(rng, reach):
    """Polygons [n, 2] in pixels, and their middle."""
    kind = rng.choice(["polygon", "ellipse", "rod", "panels", "ring", "lattice"], p=[0.24, 0.18, 0.2, 0.18, 0.08, 0.12])
    at, a = rng.normal(0, 0.35 * reach, 2), rng.uniform(0, np.pi)
    u, v = np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])
    t = np.linspace(0, 2 * np.pi, 60)
    circle = lambda p, q: np.outer(np.cos(t), u) * p + np.outer(np.sin(t), v) * q  # noqa: E731
    if kind == "polygon":
        count = int(rng.integers(3, 8))
        corner, radius = np.sort(rng.uniform(0, 2 * np.pi, count)), rng.uniform(0.15, 0.5, count) * reach
        return [at + np.stack([radius * np.cos(corner), radius * np.sin(corner)], 1)], at
    if kind == "ellipse":
        return [at + circle(*(rng.uniform(0.05, 0.45, 2) * reach))], at
    if kind == "rod":
        return [bar(at, at + rng.uniform(0.4, 1.3) * reach * u, log_uniform(rng, 0.6, 3.5))], at
    if kind == "panels":
        pitch, slit, half = rng.uniform(10, 45), rng.uniform(0.8, 6), rng.uniform(12, 70)
        places = [at + k * pitch * u for k in range(int(rng.integers(2, 7)))]
        return [bar(p, p + (pitch - slit) * u, half) for p in places], at
    if kind == "ring":
        radius, width = rng.uniform(0.1, 0.35) * reach, rng.uniform(2, 8)
        outer = circle(radius, radius * rng.uniform(0.4, 1))
        return [at + np.concatenate([outer, outer[::-1] * (1 - width / radius)])], at
    pitch, half, thick, bars = rng.uniform(10, 26), rng.uniform(8, 24), rng.uniform(0.7, 1.8), []
    for k in range(int(rng.integers(3, 8))):
        low, high = at + k * pitch * u - half * v, at + k * pitch * u + half * v
        cross = (low, high + pitch * u) if k % 2 else (high, low + pitch * u)
        bars += [bar(p, q, thick) for p, q in ((low, low + pitch * u), (high, high + pitch * u), cross, (low, high))]
    return bars, at


class Scene:
    """Shapes, screen and phone of one seed."""

    def __init__(self, seed):
        self.rng = rng = np.random.default_rng(seed)
        reach = rng.uniform(100, 210)
        self.parts = [self.part(reach) for _ in range(int(rng.integers(5, 14)))]
        bright = rng.uniform(0.15, 0.6)
        other = rng.uniform(0.06, 0.3, 2) * bright
        green = rng.random() < 0.6
        self.screen = np.array([other[0], bright, other[1]] if green else [other[0], 1.2 * other[1], bright])
        self.gain = log_uniform(rng, 0.4, 1.5)
        coarse = zoom(rng.standard_normal((3, 4)), (HEIGHT * FINE / 3, WIDTH * FINE / 4), order=1)
        folds = 4 * FINE * gaussian_filter(rng.standard_normal(coarse.shape), 2 * FINE)
        self.field = np.clip(1 + 0.25 * coarse, 0.4, 1.5) * (1 + rng.uniform(0, 0.02) * folds)
        self.shadow = rng.uniform(-30, 30, 2), np.exp(rng.uniform(0, 3)), rng.uniform(0, 0.7)
        self.style = rng.choice(["lens", "sharp", "soft"], p=[0.4, 0.3, 0.3])
        self.blur_px, self.motion_px = rng.uniform(0.3, 0.75), rng.uniform(0, 2.2)
        self.photon, self.read = log_uniform(rng, 5e-5, 1.2e-3), log_uniform(rng, 5e-4, 4e-3)
        self.start, self.step, self.phase = rng.uniform(0, 6.3), np.radians(rng.uniform(2, 9)), rng.uniform(0, 6)
        self.crf = int(rng.integers(16, 27))

    def part(self, reach):
        rng = self.rng
        polygons, middle = outline(rng, reach)
        mirror = rng.uniform(0.2, 1) if rng.random() < 0.15 else 0
        return {
            "polygons": polygons, "middle": middle, "texture": texture(rng), "mirror": mirror,
            "rim": np.exp(rng.normal(-0.3, 0.5)), "rim_px": rng.uniform(0.6, 5), "spill": rng.uniform(0, 0.15),
            "slope": rng.normal(0, 0.5, 2) / reach,
        }  # fmt: skip

    def shapes(self, n):
        """Coverage [H, W] and light [H, W, 3] of frame n, at FINE samples a pixel."""
        angle, across = self.start + 0.3 * np.sin(0.4 * n + self.phase), np.cos(self.phase + n * self.step)
        squeeze = np.diag([np.copysign(max(abs(across), 0.3), across), 1.0])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ squeeze
        shift = np.array([WIDTH / 2, HEIGHT / 2]) + self.rng.normal(0, 2, 2)
        owner = np.full((HEIGHT * FINE, WIDTH * FINE), -1, np.int16)
        for k, part in enumerate(self.parts):
            picture = Image.new("1", (WIDTH * FINE, HEIGHT * FINE))
            for polygon in part["polygons"]:
                ImageDraw.Draw(picture).polygon([tuple(p) for p in (polygon @ turn.T + shift) * FINE], fill=1)
            owner[np.asarray(picture)] = k
        inside = distance_transform_edt(owner >= 0) / FINE
        light, back = np.zeros((*owner.shape, 3), "f4"), np.linalg.inv(turn).T
        for k, part in enumerate(self.parts):
            y, x = np.where(owner == k)
            own = (np.stack([x, y], 1) / FINE - shift) @ back - part["middle"]
            at = np.round(own).astype(int) % 256
            colour = part["texture"][at[:, 1], at[:, 0]] * np.exp(np.clip(own @ part["slope"], -1.5, 1.5))[:, None]
            rim = np.exp(-inside[y, x] / part["rim_px"])[:, None]
            colour = colour * (1 + (part["rim"] - 1) * rim) + self.screen * part["spill"] * rim
            mirrored = 0.7 * part["mirror"] * self.screen * self.field[y, x][:, None] + 0.3 * colour
            light[y, x] = colour * (1 - rim) + rim * mirrored if part["mirror"] else colour
        return (owner >= 0).astype("f4"), light

    def frame(self, n):
        """8-bit sRGB picture and matte."""
        cover, light = self.shapes(n)
        move, soft, depth = self.shadow
        shadow = gaussian_filter(np.roll(cover[::4, ::4], tuple((move * FINE / 4).astype(int)), (0, 1)), soft * FINE / 4)
        screen = self.screen * (self.field * (1 - depth * np.kron(shadow, np.ones((4, 4)))))[..., None]
        light = light * cover[..., None]
        if self.style == "soft":
            cover = gaussian_filter(cover, 0.8 * FINE)
            light = cover[..., None] * gaussian_filter(light, (0.5 * FINE, 0.5 * FINE, 0))
        if self.style == "lens" and self.motion_px > 0.4:
            length = int(self.motion_px * FINE)
            light, cover = uniform_filter1d(light, length, axis=1), uniform_filter1d(cover, length, axis=1)
        picture = light + (1 - cover[..., None]) * screen
        if self.style == "lens":
            picture = gaussian_filter(picture, (self.blur_px * FINE, self.blur_px * FINE, 0))
        picture = self.gain * picture.reshape(HEIGHT, FINE, WIDTH, FINE, 3).mean((1, 3))
        sigma = np.sqrt(self.photon * np.clip(picture, 0, None) + self.read**2)
        v = np.clip(picture + sigma * self.rng.standard_normal(picture.shape), 0, 1)
        coded = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
        matte = cover.reshape(HEIGHT, FINE, WIDTH, FINE).mean((1, 3))
        return (255 * coded + 0.5).astype("u1"), (255 * matte + 0.5).astype("u1")


def film(seed, folder):
    scene = Scene(seed)
    os.makedirs(f"{folder}/mattes", exist_ok=True)
    size = ["-pix_fmt", "rgb24", "-s", f"{WIDTH}x{HEIGHT}", "-r", "10", "-i", "-"]
    code = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", str(scene.crf), f"{folder}/video.mp4"]
    with subprocess.Popen(["ffmpeg", "-y", "-v", "error", "-f", "rawvideo", *size, *code], stdin=subprocess.PIPE) as coder:
        for n in range(FRAMES):
            picture, matte = scene.frame(n)
            coder.stdin.write(picture.tobytes())
            Image.fromarray(matte).save(f"{folder}/mattes/frame_{n:06d}.png")
    if coder.returncode:
        raise SystemExit(f"ffmpeg could not write {folder}/video.mp4")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    options = parser.parse_args()
    for seed in range(options.first, options.last):
        film(seed, f"{options.folder}/{seed:03d}")


if __name__ == "__main__":
    main()
