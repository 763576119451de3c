"""Pictures of the made-wrong set: copies, mirrored and turned ones, videos from frames, EXIF."""

import os
import subprocess

import numpy as np
from PIL import Image

import motions


def save(pixels, path):
    Image.fromarray(pixels).save(path, quality=95, subsampling=0)


def copy_photo(path, target, mirrored=False):
    """As JPEG under another name, over black where it is transparent; a JPEG byte for byte."""
    if path.endswith(".jpg") and not mirrored:
        with open(path, "rb") as source, open(target, "wb") as copy:
            copy.write(source.read())
        return
    picture = Image.open(path)
    if picture.mode == "RGBA":
        black = Image.new("RGBA", picture.size, (0, 0, 0, 255))
        picture = Image.alpha_composite(black, picture)
    pixels = np.asarray(picture.convert("RGB"))
    save(pixels[:, ::-1] if mirrored else pixels, target)


def read_truth(folder):
    """(camera line, {stem: (R, t)}) of a COLMAP text model that the suite wrote."""
    with open(os.path.join(folder, "cameras.txt")) as file:
        camera = [line for line in file if not line.startswith("#")][0].split(maxsplit=1)[1].strip()
    poses = {}
    with open(os.path.join(folder, "images.txt")) as file:
        for line in file:
            word = line.split()
            if word and word[0] != "#":
                q = np.array([float(x) for x in word[1:5]])
                poses[os.path.splitext(word[9])[0]] = (motions.quaternion_matrix(q), np.array([float(x) for x in word[5:8]]))
    return camera, poses


def decode(path, width=640, height=480):
    """All frames of a video [n, H, W, 3]."""
    command = ["ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, check=True, capture_output=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3)


def encode(path, pictures, fps):
    """H.264, frame k at k / fps."""
    height, width = pictures.shape[1:3]
    command = ["ffmpeg", "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-",
               "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-c:v", "libx264", "-crf", "16", "-pix_fmt", "yuv420p", "-threads", "1",
               "-colorspace", "bt709", "-color_range", "tv", "-fflags", "+bitexact", "-flags:v", "+bitexact", path]
    subprocess.run(command, input=np.ascontiguousarray(pictures).tobytes(), check=True)


def side_by_side(left, right):
    """Two videos of one size, halved, in the middle of a picture that repeats their margins."""
    half = [(v[:, ::2, ::2] // 4 + v[:, 1::2, ::2] // 4 + v[:, ::2, 1::2] // 4 + v[:, 1::2, 1::2] // 4) for v in (left, right)]
    both = np.concatenate(half, axis=2)
    pad = (left.shape[1] - both.shape[1]) // 2
    return np.pad(both, [(0, 0), (pad, pad), (0, 0), (0, 0)], mode="edge")


def homography(picture, H, width, height):
    """The picture at H times each pixel's place, bilinear; [height, width, 3]."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    p = np.stack([x, y, np.ones_like(x)], -1) @ H.T
    u, v = p[..., 0] / p[..., 2] - 0.5, p[..., 1] / p[..., 2] - 0.5
    rows, columns = picture.shape[:2]
    u, v = np.clip(u, 0, columns - 1.001), np.clip(v, 0, rows - 1.001)
    i, j = u.astype(int), v.astype(int)
    a, b = (u - i)[..., None], (v - j)[..., None]
    top = picture[j, i] * (1 - a) + picture[j, i + 1] * a
    return top * (1 - b) + (picture[j + 1, i] * (1 - a) + picture[j + 1, i + 1] * a) * b


def rotate_about_centre(folder, path, count):
    """Views of one large photo from its own centre, with noise; the truth has rotations alone."""
    big = np.asarray(Image.open(path).convert("RGB")).astype(np.float32)
    rows, columns = big.shape[:2]
    wide, width, height, f = 0.75 * columns, 640, 480, 700.0
    K = np.array([[wide, 0, columns / 2], [0, wide, rows / 2], [0, 0, 1]])
    small = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    rng, poses = np.random.default_rng(6), {}
    for k in range(count):
        a = 2 * np.pi * k / count
        turn = motions.axis_angle([0, 1, 0], 0.16 * np.cos(a)) @ motions.axis_angle([1, 0, 0], 0.06 * np.sin(2 * a))
        turn = motions.axis_angle([0, 0, 1], 0.05 * np.sin(a)) @ turn
        seen = homography(big, K @ turn.T @ np.linalg.inv(small), width, height)
        save(np.clip(np.rint(seen + rng.normal(0, 2, seen.shape)), 0, 255).astype(np.uint8), os.path.join(folder, "images", f"photo_{k:03d}.jpg"))
        poses[f"photo_{k:03d}"] = (turn, np.zeros(3))
    return {"rotations": (f"PINHOLE {width} {height} {f} {f} {width / 2} {height / 2}", poses)}


def write_focal_exif(path, millimetres):
    """Puts a 35-mm-equivalent focal length into a JPEG without touching its pixels."""
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = "Testbed", "Suite"
    exif.get_ifd(0x8769).update({0x920A: float(millimetres), 0xA405: int(millimetres)})
    payload = b"Exif\0\0" + exif.tobytes().removeprefix(b"Exif\0\0")
    with open(path, "rb") as file:
        data = file.read()
    segment = b"\xff\xe1" + (len(payload) + 2).to_bytes(2, "big") + payload
    with open(path, "wb") as file:
        file.write(data[:2] + segment + data[2:])
