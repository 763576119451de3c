#!/usr/bin/env python3
"""How well `sat-recon render --light` shows the test bed's yaw at 100 % light with the lamp elsewhere.

    bench_relight.py SAT_RECON --out FOLDER [--object NAME=KIND ...] [--every 3] [--quality fast]

Films each object (mock-up, and satellites drawn at random: NAME=variant:SEED) as case 4, every third
frame, makes its splat, and renders the held-out frames anew with the lamp turned about the vertical
axis. Table `relight`: PSNR inside the matte against those frames, mean and worst view: of the splat
as it is, and relit. Frames and runs that exist are kept. Needs blender, python3-numpy and
python3-pil (Debian's).
"""
import argparse
import json
import math
import os
import struct
import subprocess
import sys

import numpy as np
from PIL import Image

import bench_results

HERE = os.path.dirname(os.path.abspath(__file__))
BED = os.path.join(HERE, "../data/testbed")
sys.path.insert(0, BED)
import cases  # noqa: E402
from imagefiles import read_exr  # noqa: E402

CASE = cases.CASES["case4"]
SHOT = cases.SHOTS[CASE.shot]
LAMP = np.array([-1.15, -1.75, 0.95])  # rooms.green_screen
TURNS_DEG = (-30, 30, 60)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary")
    parser.add_argument("--out", required=True)
    parser.add_argument("--object", nargs="*", default=["variant5=variant:5", "variant9=variant:9", "mock-up="])
    parser.add_argument("--every", type=int, default=3)
    parser.add_argument("--quality", default="fast")
    args = parser.parse_args()
    table = bench_results.Table(os.path.join(args.out, "results"), "relight", [
        "object", "lamp turned by", "splat as it is, dB: mean, worst", "relit", "gain"])
    for name, kind in (o.split("=") for o in args.object):
        folder = os.path.join(args.out, name)
        run = filmed(args, folder, kind)
        frames = held_out(run)
        view = View(run, folder, args.every)
        render(args.binary, run, os.path.join(folder, "as-it-is"), [])
        for turn in TURNS_DEG:
            truth(folder, kind, frames, args.every, turn)
            shown = os.path.join(folder, f"relit{turn}")
            said = render(args.binary, run, shown, [f"--light={angles(turn)}"])
            print(f"{name}, {turn}°: {said}", flush=True)
            before, after = ([view.psnr(os.path.join(f, n), n, turn) for n in frames]
                             for f in (os.path.join(folder, "as-it-is"), shown))
            cells = [f"{np.mean(p):.2f}, {min(p):.2f}" for p in (before, after)]
            table.row([name, f"{turn}°", *cells, f"{np.mean(after) - np.mean(before):+.2f}"])


def filmed(args, folder, kind):
    """The run of an object's capture."""
    run = os.path.join(folder, "run")
    if not os.path.exists(os.path.join(run, "run.json")):
        env = {**os.environ, "EVERY": str(args.every), **({"OBJECT": kind} if kind else {})}
        subprocess.run(["bash", os.path.join(BED, "make.sh"), folder, "case4"], env=env, check=True)
        video = os.path.join(folder, "case4/video.mp4")
        code = subprocess.run([args.binary, video, "-o", run, "-q", "--quality", args.quality]).returncode
        if code not in (0, 3):
            sys.exit(f"{video}: exit code {code}")
    return run


def held_out(run):
    with open(os.path.join(run, "run.json")) as file:
        return [view["name"] for view in json.load(file)["evaluation"]["views"]]


def number(name):
    """Which frame of the video."""
    return int("".join(c for c in os.path.splitext(name)[0] if c.isdigit()))


def truth(folder, kind, frames, every, turn):
    """The satellite alone with the lamp turned."""
    wanted = ",".join(f"{number(n) * every}:{number(n) * every + 1}:1" for n in frames)
    target = os.path.join(folder, f"relit/lamp{turn}")
    os.makedirs(target, exist_ok=True)
    command = ["nice", "-n", "19", "blender", "-b", "-t", "1", "--python-exit-code", "1", "--python",
               os.path.join(BED, "render.py"), "--", SHOT.name, target, "--layer", "front", "--frames", wanted,
               "--lamp-turn", str(turn), *(["--object", kind] if kind else [])]
    with open(os.path.join(target, "blender.log"), "w") as log:
        subprocess.run(command, check=True, stdout=log, stderr=log)


def angles(turn):
    """Azimuth and elevation of the turned lamp as the camera sees it."""
    R, _ = cases.camera_from_world(SHOT, 0)
    x, y, z = R @ cases.rotation("z", math.radians(turn)) @ LAMP / np.linalg.norm(LAMP)
    return f"{math.degrees(math.atan2(x, -z)):.1f},{math.degrees(math.asin(-y)):.1f}"


def render(binary, run, target, flags):
    """Pictures of the held-out views; what the program says last."""
    done = subprocess.run([binary, "render", run, "-o", target, "--path", "test", *flags],
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode not in (0, 3, 4):  # a doubtful lamp is still shown
        sys.exit(f"{run}: exit code {done.returncode}: {done.stdout}")
    return done.stdout.strip().splitlines()[-1]


class View:
    """From true light to a run's undistorted pictures."""

    def __init__(self, run, folder, every):
        self.folder, self.every = folder, every
        self.size, self.lens = camera(os.path.join(run, "undistorted/sparse/0"))
        self.place = (0.0, 0.0, 1.0)
        self.align(run, held_out(run)[::4])

    def align(self, run, names):
        """The run's principal point and focal length are its own: the shift, px, and the scale
        under which its photos are most like the true light as filmed."""
        def alike(place):
            self.place = place
            return np.mean([self.psnr(os.path.join(run, "undistorted/images", n), n, None) for n in names])
        best, step = self.place, 1.0
        found = alike(best)
        while step >= 0.1:
            around = [tuple(np.array(best) + step * sign * np.array(axis))
                      for axis in ((2, 0, 0), (0, 2, 0), (0, 0, 0.01)) for sign in (-1, 1)]
            value, place = max((alike(p), p) for p in around)
            if value > found:
                best, found = place, value
            else:
                step /= 2
        self.place = best
        print(f"{self.folder}: photos {found:.2f} dB from the true light; moved by "
              f"{best[0]:.2f}, {best[1]:.2f} px, scaled by {best[2]:.4f}", flush=True)

    def light(self, name, turn):
        """What the lamp shows, sRGB, and where the satellite fills the pixel."""
        folder = "renders/yaw" if turn is None else f"relit/lamp{turn}"
        exr = read_exr(os.path.join(self.folder, folder, f"front/{number(name) * self.every:04d}.exr"))
        passes = {g: np.stack([exr[f"L.Combined_{g}.{c}"] for c in "RGB"], -1) for g in ("lamp", "room")}
        cover = exr["L.Combined.A"][..., None]
        f, c = self.lens
        grid = np.stack(np.meshgrid(np.arange(self.size[0]) + 0.5, np.arange(self.size[1]) + 0.5), -1)
        ray = (grid - c + self.place[:2]) / (f * self.place[2])
        vignette = CASE.exposure / (1 + 0.22 * (ray**2).sum(-1, keepdims=True))  # develop.sensor
        seen = sample(np.concatenate([CASE.lamp * passes["lamp"] + CASE.room * passes["room"], cover], -1), ray)
        v = np.clip(seen[..., :3] * vignette, 0, 1)
        return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055), seen[..., 3] > 0.98

    def psnr(self, picture, name, turn):
        light, inside = self.light(name, turn)
        shown = np.asarray(Image.open(os.path.splitext(picture)[0] + ".png").convert("RGB")) / 255
        # A pixel at the border is part background.
        inside[1:-1, 1:-1] &= inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
        return -10 * math.log10(((shown - light) ** 2)[inside].mean())


def camera(model):
    """Size, [focal lengths, principal point] of the one camera (PINHOLE) of a COLMAP model."""
    with open(os.path.join(model, "cameras.bin"), "rb") as file:
        _count, _id, kind, width, height, *lens = struct.unpack("<QiiQQ4d", file.read(64))
    if kind != 1:
        sys.exit(f"{model}: its camera is not PINHOLE")
    return (width, height), np.reshape(lens, (2, 2))


def sample(image, ray):
    """Bilinear, from Blender's undistorted picture."""
    width, height, f = cases.render_size(SHOT, SHOT.density)
    x = np.clip(f * ray[..., 0] + width / 2 - 0.5, 0, width - 1.001)
    y = np.clip(f * ray[..., 1] + height / 2 - 0.5, 0, height - 1.001)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - left)[..., None], (y - top)[..., None]
    above = (1 - a) * image[top, left] + a * image[top, left + 1]
    return (1 - b) * above + b * ((1 - a) * image[top + 1, left] + a * image[top + 1, left + 1])


if __name__ == "__main__":
    main()
