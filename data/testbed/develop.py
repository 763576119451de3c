"""The phone: turns a shot's linear renders into the picture a phone would have stored, with truth.

    python3 develop.py CASE RENDERS FOLDER [--every K] [--blue]

RENDERS is the folder render.py wrote; with K only every K-th frame is filmed, at a K-th of the
rate. In order: layers joined, lamp and room mixed, lens distortion and off-centre principal point
(resampling), vignetting, exposure, photon and read noise in linear light, clipping, sRGB, 8 bits,
then H.264 4:2:0 or JPEG. The truth goes through the same lens. With --blue, green and blue light
are exchanged before the sensor: the screen is blue, and other colours are others too.
"""

import argparse
import os
import shutil
import subprocess

import numpy as np

import cases
from imagefiles import read_exr, write_png


class LensMap:
    """Where each of 2 x 2 points in every pixel lies in the wide render; bilinear, then
    averaged."""

    def __init__(self, shot, density):
        lens = shot.lens
        width, height, f = cases.render_size(shot, density)
        u, v = np.meshgrid(np.arange(2 * lens.width) / 2 + 0.25, np.arange(2 * lens.height) / 2 + 0.25)
        x, y = cases.undistort(lens, u, v)
        # Pixel (0, 0) is the corner: sample k of the render lies at k + 0.5.
        x = np.clip(f * x + width / 2 - 0.5, 0, width - 1.001)
        y = np.clip(f * y + height / 2 - 0.5, 0, height - 1.001)
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        a, b = x - left, y - top
        # Corner of the cell as a flat index, weights of its four corners; the four points of a
        # pixel together.
        corner = top * width + left
        weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
        points = [(j, i) for j in range(2) for i in range(2)]
        self.corner = np.concatenate([corner[j::2, i::2].ravel() for j, i in points])
        self.weights = np.concatenate([weights[:, j::2, i::2].reshape(4, -1) for j, i in points], 1) / 4
        self.weights = self.weights.astype(np.float32)[..., None]
        self.steps = (0, 1, width, width + 1)
        self.r2 = ((u - lens.cx) ** 2 + (v - lens.cy) ** 2)[::2, ::2] / lens.f**2

    def __call__(self, image):
        flat = image.reshape(-1, image.shape[2]).astype(np.float32)
        seen = sum(w * flat[self.corner + step] for w, step in zip(self.weights, self.steps))
        return seen.reshape(4, *self.r2.shape, -1).sum(axis=0)


def ratio(back, base):
    """Change of light that the satellite brings: 0 in its shadow, a little over 1 where it
    reflects.

    Few samples leave single bright pixels: the median of 3 x 3 takes them out, and what the
    satellite adds is limited to two fifths."""
    wide = np.pad((back + 1e-4) / (base + 1e-4), ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = base.shape[:2]
    around = [wide[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.clip(np.median(around, axis=0), 0.0, 1.4)


class Renders:
    """The layers of a shot, joined and seen through the lens: light without noise, and truth."""

    def __init__(self, shot, case, folder):
        self.shot, self.case, self.folder = shot, case, folder
        self.maps = {name: LensMap(shot, density) for name, (_, _, density) in cases.layers(shot).items()}
        self.r2 = next(iter(self.maps.values())).r2
        if shot.layers == "static":
            clean, base = self.read("clean", 0), self.read("base", 0)
            self.clean = {g: self.maps["clean"](clean[g]) for g in ("lamp", "room", "truth")}
            self.base = base

    def read(self, layer, i):
        """The passes of one render: `lamp`, `room`, `truth` [H, W, 3] and `cover` [H, W, 1]."""
        exr = read_exr(f"{self.folder}/{layer}/{i:04d}.exr")
        passes = {"lamp": "Combined_lamp", "room": "Combined_room", "truth": "truth"}
        found = {key: np.stack([exr[f"L.{name}.{c}"] for c in "RGB"], -1) for key, name in passes.items()}
        return {**found, "cover": exr["L.Combined.A"][..., None]}

    def mix(self, passes):
        return self.case.lamp * passes["lamp"] + self.case.room * passes["room"]

    def background(self, i):
        """(light, truth) of room and pole in frame i."""
        back = self.read("back", i)
        if self.shot.layers == "moving":
            return self.maps["back"](self.mix(back)), self.maps["back"](back["truth"])
        changed = {g: ratio(back[g], self.base[g]) for g in ("lamp", "room")}
        return self.mix({g: self.clean[g] * self.maps["back"](changed[g]) for g in changed}), self.clean["truth"]

    def __getitem__(self, i):
        """(light [H, W, 3], truth [H, W, 3]) of frame i in the phone's pixels."""
        name = "whole" if self.shot.layers == "whole" else "front"
        front, lens = self.read(name, i), self.maps[name]
        light, truth = lens(self.mix(front)), lens(front["truth"])
        if name == "front":
            light_behind, truth_behind = self.background(i)
            through = 1 - lens(front["cover"])
            light, truth = light + through * light_behind, truth + through * truth_behind
        return light, truth


def sensor(light, case, r2, rng):
    """Linear light to sRGB bytes: cos^2-like fall-off, then noise whose variance is light +
    constant."""
    light = light * (case.exposure / (1 + 0.22 * r2))[..., None]
    variance = np.maximum(light, 0) / case.full_well + (case.read_noise / case.full_well) ** 2
    light = np.clip(light + rng.normal(size=light.shape) * np.sqrt(variance), 0, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255 * srgb).astype(np.uint8)


def film(light, case, r2, seed, takes):
    """One picture; or the mean of `takes` of them, none of which is that one."""
    if takes == 1:
        return sensor(light, case, r2, np.random.default_rng(seed))
    draws = (sensor(light, case, r2, np.random.default_rng([*seed, k])) for k in range(1, takes + 1))
    return np.round(sum(draw.astype(float) for draw in draws) / takes).astype(np.uint8)


def byte(x):
    return np.round(255 * np.clip(x, 0, 1)).astype(np.uint8)


def frame_name(case, i):
    return f"frame_{i:06d}.png" if case.video_fps else f"still_{i:03d}.jpg"


def write_truth(truth, case, shot, i, folder):
    """Matte of the satellite, matte of the pole, depth in 0.1 mm (0: none)."""
    stem = frame_name(case, i).rsplit(".", 1)[0]
    if i % case.truth_every == 0:
        write_png(f"{folder}/mattes/{stem}.png", byte(truth[..., 0]))
        write_png(f"{folder}/pole/{stem}.png", byte(truth[..., 1]))
    if i % case.depth_every == 0:
        alpha = truth[..., 0]
        inside = alpha > 0.98
        depth = truth[..., 2] / np.where(inside, alpha, 1) + shot.distance_m
        write_png(f"{folder}/depth/{stem}.png", np.where(inside, np.round(1e4 * depth), 0).astype(np.uint16))


def quaternion(R):
    """Unit quaternion (w, x, y, z), w >= 0, from the largest eigenvector of Bar-Itzhack's
    matrix."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
            [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    x, y, z, w = np.linalg.eigh(K)[1][:, -1]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def write_model(case, shot, frames, folder):
    """The true poses of `frames` as a COLMAP text model without points, and the true angles of a
    yaw."""
    os.makedirs(f"{folder}/sparse", exist_ok=True)
    with open(f"{folder}/sparse/cameras.txt", "w") as file:
        file.write(f"# the true camera\n1 {shot.lens.colmap()}\n")
    with open(f"{folder}/sparse/images.txt", "w") as file:
        file.write("# the true poses, camera from satellite: id qw qx qy qz tx ty tz camera name\n")
        for k, i in enumerate(frames):
            R, t = cases.camera_from_satellite(shot, i)
            numbers = " ".join(f"{x:.12g}" for x in (*quaternion(R), *t))
            file.write(f"{k + 1} {numbers} 1 {frame_name(case, k)}\n\n")
    with open(f"{folder}/sparse/points3D.txt", "w") as file:
        file.write("# none: the shape is in mesh.ply\n")
    if shot.path == "yaw":
        with open(f"{folder}/angles_deg.txt", "w") as file:
            file.write("# turn of the satellite about +z in each frame, degrees\n")
            file.writelines(f"{np.degrees(cases.yaw_angle(shot, i)):.9f}\n" for i in frames)


def encoder(case, shot, options, folder):
    """ffmpeg reading raw RGB: a video (H.264, 4:2:0, BT.709), JPEG stills, or PNG stills that are
    means."""
    source = f"ffmpeg -y -v error -f rawvideo -pix_fmt rgb24 -s {shot.lens.width}x{shot.lens.height}"
    if case.video_fps:
        rest = (
            f"-r {case.video_fps / options.every:g} -i - -vf scale=out_color_matrix=bt709:out_range=tv -c:v libx264 -preset slow"
            f" -crf {options.crf or case.crf} -pix_fmt {options.pix_fmt} -colorspace bt709 -color_primaries bt709 -color_trc iec61966-2-1"
            f" -color_range tv -bf 2 -g 48 -threads 1 -fflags +bitexact -flags:v +bitexact -movflags +faststart {folder}/video.mp4"
        )
    else:
        form = "-pix_fmt yuvj420p -q:v 3" if options.takes == 1 else "-pix_fmt rgb24"
        name = "still_%03d." + ("jpg" if options.takes == 1 else "png")
        rest = f"-i - {form} -start_number 0 {folder}/images/{name}"
    return subprocess.Popen((source + " " + rest).split(), stdin=subprocess.PIPE)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("case", choices=sorted(cases.CASES))
    parser.add_argument("renders")
    parser.add_argument("folder")
    parser.add_argument("--every", type=int, default=1, help="film only every k-th frame")
    parser.add_argument("--blue", action="store_true", help="exchange green and blue light")
    parser.add_argument("--takes", type=int, default=1, help="stills that are the mean of so many other draws of the noise, as PNG: what no rendering can do better than")
    parser.add_argument("--crf", type=int, help="quality of the video (x264), instead of the case's")
    parser.add_argument("--pix-fmt", default="yuv420p", help="how the video keeps colour: yuv444p for all of it")
    options = parser.parse_args()
    case, folder = cases.CASES[options.case], options.folder
    if options.takes > 1 and case.video_fps:
        parser.error("--takes is for stills")
    shot = cases.SHOTS[case.shot]
    for part in ("mattes", "pole", "depth") + (() if case.video_fps else ("images",)):
        os.makedirs(f"{folder}/{part}", exist_ok=True)
    renders = Renders(shot, case, options.renders)
    sink = encoder(case, shot, options, folder)
    frames = range(0, shot.frames, options.every)
    for k, i in enumerate(frames):
        light, truth = renders[i]
        light = light[..., [0, 2, 1]] if options.blue else light
        seed = [i, len(case.name), ord(case.name[-1])]
        sink.stdin.write(film(light, case, renders.r2, seed, options.takes).tobytes())
        write_truth(truth, case, shot, k, folder)
    sink.stdin.close()
    if sink.wait() != 0:
        raise SystemExit("ffmpeg failed")
    write_model(case, shot, frames, folder)
    shutil.copy(f"{options.renders}/mesh.ply", f"{folder}/mesh.ply")


if __name__ == "__main__":
    main()
