"""COLMAP models as plain Python values: read, written as text or binary, compared with another.

A model is {"cameras": {id: [model, width, height, [parameters]]},
            "images": {id: {"q": [4], "t": [3], "camera": id, "name": str, "seen": [[x, y, point]]}},
            "points": {id: {"x": [3], "rgb": [3], "error": px, "track": [[image, index]]}}}
with the conventions of COLMAP's documentation; a keypoint that sees nothing has point -1.
"""
import os
import struct

import numpy as np

MODELS = {"SIMPLE_PINHOLE": (0, 3), "PINHOLE": (1, 4), "SIMPLE_RADIAL": (2, 4), "RADIAL": (3, 5), "OPENCV": (4, 8)}
NAMES = {number: name for name, (number, _) in MODELS.items()}


def read(folder):
    """The binary model in a folder."""
    return {"cameras": read_cameras(folder), "images": read_images(folder), "points": read_points(folder)}


class Bytes:
    """A file read from front to back."""

    def __init__(self, path):
        with open(path, "rb") as file:
            self.data, self.at = file.read(), 0

    def take(self, form):
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return list(values)

    def text(self):
        end = self.data.index(0, self.at)
        text, self.at = self.data[self.at : end].decode(), end + 1
        return text


def read_cameras(folder):
    file, cameras = Bytes(os.path.join(folder, "cameras.bin")), {}
    for _ in range(file.take("Q")[0]):
        number, model, width, height = file.take("IiQQ")
        cameras[number] = [NAMES[model], width, height, file.take(f"{MODELS[NAMES[model]][1]}d")]
    return cameras


def read_images(folder):
    file, images = Bytes(os.path.join(folder, "images.bin")), {}
    for _ in range(file.take("Q")[0]):
        number, *pose, camera = file.take("I7dI")
        name = file.text()
        seen = [file.take("ddq") for _ in range(file.take("Q")[0])]
        images[number] = {"q": pose[:4], "t": pose[4:], "camera": camera, "name": name, "seen": seen}
    return images


def read_points(folder):
    file, points = Bytes(os.path.join(folder, "points3D.bin")), {}
    for _ in range(file.take("Q")[0]):
        number, *values = file.take("Q3d3BdQ")
        track = [file.take("II") for _ in range(values[7])]
        points[number] = {"x": values[:3], "rgb": values[3:6], "error": values[6], "track": track}
    return points


def write_text(model, folder):
    """Writes cameras.txt, images.txt and points3D.txt."""
    os.makedirs(folder, exist_ok=True)
    join = lambda values: " ".join(map(str, values))
    with open(os.path.join(folder, "cameras.txt"), "w") as file:
        for number, (name, width, height, parameters) in model["cameras"].items():
            file.write(f"{number} {name} {width} {height} {join(parameters)}\n")
    with open(os.path.join(folder, "images.txt"), "w") as file:
        for number, image in model["images"].items():
            file.write(f"{number} {join(image['q'])} {join(image['t'])} {image['camera']} {image['name']}\n")
            file.write(join(join(s) for s in image["seen"]) + "\n")
    with open(os.path.join(folder, "points3D.txt"), "w") as file:
        for number, p in model["points"].items():
            track = join(join(t) for t in p["track"])
            file.write(f"{number} {join(p['x'])} {join(p['rgb'])} {p['error']} {track}\n")


def write_binary(model, folder):
    """Writes cameras.bin, images.bin and points3D.bin; numbers that do not fit are cut to fit."""
    os.makedirs(folder, exist_ok=True)
    u32, u64 = (lambda v: int(v) & 0xFFFFFFFF), (lambda v: int(v) & 0xFFFFFFFFFFFFFFFF)
    out = [struct.pack("<Q", len(model["cameras"]))]
    for number, (name, width, height, parameters) in model["cameras"].items():
        out.append(struct.pack("<IiQQ", u32(number), MODELS.get(name, (99,))[0], u64(width), u64(height)))
        out.append(struct.pack(f"<{len(parameters)}d", *parameters))
    save(folder, "cameras.bin", out)
    out = [struct.pack("<Q", len(model["images"]))]
    for number, image in model["images"].items():
        out.append(struct.pack("<I7dI", u32(number), *image["q"], *image["t"], u32(image["camera"])))
        out.append(image["name"].encode() + b"\0" + struct.pack("<Q", len(image["seen"])))
        out += [struct.pack("<ddQ", x, y, u64(p)) for x, y, p in image["seen"]]
    save(folder, "images.bin", out)
    out = [struct.pack("<Q", len(model["points"]))]
    for number, p in model["points"].items():
        rgb = [int(c) & 255 for c in p["rgb"]]
        out.append(struct.pack("<Q3d3BdQ", u64(number), *p["x"], *rgb, p["error"], len(p["track"])))
        out += [struct.pack("<II", u32(i), u32(k)) for i, k in p["track"]]
    save(folder, "points3D.bin", out)


def save(folder, name, parts):
    with open(os.path.join(folder, name), "wb") as file:
        file.write(b"".join(parts))


def rotation(q):
    """Matrix of a quaternion w x y z of any length."""
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def project(camera, xyz):
    """Pixels [n, 2] of points [n, 3] in the frame of a camera."""
    name, _, _, p = camera
    u, v = xyz[:, 0] / xyz[:, 2], xyz[:, 1] / xyz[:, 2]
    single = name in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    fx, fy, cx, cy, rest = (p[0], p[0], p[1], p[2], p[3:]) if single else (*p[:4], p[4:])
    k1, k2, p1, p2 = (list(rest) + [0, 0, 0, 0])[:4]
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2 * r2
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    y = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return np.stack([fx * x + cx, fy * y + cy], 1)


def errors(model):
    """Reprojection errors of all observations, px; infinite behind the camera."""
    found = []
    for point in model["points"].values():
        for number, index in point["track"]:
            image = model["images"][number]
            local = rotation(image["q"]) @ np.array(point["x"]) + np.array(image["t"])
            pixel = project(model["cameras"][image["camera"]], local[None])[0]
            apart = np.linalg.norm(pixel - np.array(image["seen"][index][:2]))
            found.append(apart if local[2] > 0 else np.inf)
    return np.array(found)


def aligned(source, target):
    """(scale, R, t) of the similarity that maps points onto others best (Umeyama 1991)."""
    a, b = source.mean(0), target.mean(0)
    x, y = source - a, target - b
    U, S, Vt = np.linalg.svd(y.T @ x / len(x))
    D = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    R = U @ D @ Vt
    scale = np.trace(np.diag(S) @ D) / max((x * x).sum() / len(x), 1e-300)
    return scale, R, b - scale * R @ a


def differences(found, true, sizes):
    """What is wrong with a model, in words; nothing where it agrees with the true one.

    sizes: {name: (width, height)} of the images' files. Wrong are: other images; cameras that send
    rays elsewhere by more than 2 % of the image; after a similarity, rotations by more than 1° and
    centres by more than 2 % of their extent; more than 1 % of observations more than 5 % of the
    image away from where their points are seen.
    """
    by_name = {i["name"]: i for i in found["images"].values()}
    truth = {i["name"]: i for i in true["images"].values()}
    if set(by_name) != set(truth):
        return ["other images"]
    wrong, side = [], max(next(iter(sizes.values())))
    grid = np.array([[x, y, 1.0] for x in np.linspace(-0.5, 0.5, 5) for y in np.linspace(-0.4, 0.4, 5)])
    for name, image in by_name.items():
        camera, other = found["cameras"][image["camera"]], true["cameras"][truth[name]["camera"]]
        if (camera[1], camera[2]) != sizes[name]:
            wrong.append(f"size of {name}")
        apart = np.linalg.norm(project(camera, grid) - project(other, grid), axis=1)
        if not np.median(apart) < 0.02 * side:
            wrong.append(f"camera of {name}")
    names = sorted(truth)
    poses = [[(rotation(m[n]["q"]), np.array(m[n]["t"])) for n in names] for m in (by_name, truth)]
    centres = [np.array([-R.T @ t for R, t in p]) for p in poses]
    if not np.isfinite(centres[0]).all():
        return wrong + ["poses that are not finite"]
    scale, R, t = aligned(*centres)
    extent = np.linalg.norm(centres[1] - centres[1].mean(0), axis=1).max()
    away = np.linalg.norm(scale * centres[0] @ R.T + t - centres[1], axis=1) / extent
    for k, name in enumerate(names):
        turn = poses[0][k][0] @ R.T @ poses[1][k][0].T
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        if not (away[k] < 0.02 and angle < 1):
            wrong.append(f"pose of {name}: {100 * away[k]:.1f} % and {angle:.1f}°")
    residuals = errors(found)
    if len(residuals) and np.mean(~(residuals < 0.05 * side)) > 0.01:
        wrong.append(f"{100 * np.mean(~(residuals < 0.05 * side)):.0f} % of observations")
    return wrong
