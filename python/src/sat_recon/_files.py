"""Readers of the result's files: COLMAP's binary models and splats, as numpy arrays."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# COLMAP's camera models by number: name, number of parameters (colmap/sensor/models.h's table).
_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
}


@dataclass(frozen=True)
class Camera:
    """A camera as COLMAP has it: pixels, centre of the first pixel at (0.5, 0.5)."""

    model: str
    width: int
    height: int
    params: np.ndarray
    """Focal lengths, principal point, distortion, in the order of COLMAP's model."""

    @property
    def matrix(self) -> np.ndarray:
        """3×3 matrix of the focal lengths and the principal point, without the distortion."""
        one_focal = self.model.startswith(("SIMPLE", "RADIAL"))
        fx, fy, cx, cy = self.params[[0, 0, 1, 2] if one_focal else [0, 1, 2, 3]]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


class _Reader:
    def __init__(self, path: Path):
        self.bytes, self.at = path.read_bytes(), 0

    def take(self, form: str) -> tuple:
        values = struct.unpack_from("<" + form, self.bytes, self.at)
        self.at += struct.calcsize("<" + form)
        return values

    def skip(self, size: int) -> None:
        self.at += size

    def text(self) -> str:
        end = self.bytes.index(b"\0", self.at)
        text = self.bytes[self.at:end].decode("utf-8")
        self.at = end + 1
        return text


def read_cameras(path: Path) -> dict[int, Camera]:
    """Cameras of ``cameras.bin`` by number."""
    reader = _Reader(path)
    cameras = {}
    for _ in range(reader.take("Q")[0]):
        number, model, width, height = reader.take("iiQQ")
        name, count = _MODELS[model]
        cameras[number] = Camera(name, width, height, np.array(reader.take(f"{count}d")))
    return cameras


def rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of quaternions (n, 4), w first."""
    w, x, y, z = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def read_images(path: Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, cameras' numbers and camera-from-world matrices (n, 4, 4) of ``images.bin``, by name."""
    reader = _Reader(path)
    rows = []
    for _ in range(reader.take("Q")[0]):
        values = reader.take("i7di")
        name = reader.text()
        reader.skip(24 * reader.take("Q")[0])  # x, y, number of the point
        rows.append((name, values))
    rows.sort(key=lambda row: row[0])
    numbers = np.array([values[8] for _, values in rows], dtype=int)
    poses = np.array([values[1:8] for _, values in rows]).reshape(-1, 7)
    matrices = np.tile(np.eye(4), (len(rows), 1, 1))
    if rows:
        matrices[:, :3, :3], matrices[:, :3, 3] = rotations(poses[:, :4]), poses[:, 4:]
    return [name for name, _ in rows], numbers, matrices


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (m, 3), colours (m, 3; bytes) and reprojection errors (m; pixels)."""
    reader = _Reader(path)
    rows = []
    for _ in range(reader.take("Q")[0]):
        rows.append(reader.take("Q3d3Bd"))
        reader.skip(8 * reader.take("Q")[0])  # number of the image, of the keypoint
    table = np.array(rows, dtype=float).reshape(-1, 8)
    return table[:, 1:4], table[:, 4:7].astype(np.uint8), table[:, 7]


@dataclass(frozen=True)
class Splat:
    """3D Gaussians, in the world of the poses."""

    means: np.ndarray
    """Centres, (n, 3)."""
    scales: np.ndarray
    """Standard deviations along the axes, (n, 3)."""
    quaternions: np.ndarray
    """Orientations of the axes, w first, of length 1, (n, 4)."""
    opacities: np.ndarray
    """Between 0 and 1, (n,)."""
    sh: np.ndarray
    """Spherical harmonics of the colour, (n, (degree + 1)², 3)."""

    def __len__(self) -> int:
        return len(self.means)


def read_splat(path: Path) -> Splat:
    """A splat of the usual .ply."""
    content = path.read_bytes()
    mark = b"end_header\n"
    end = content.index(mark) + len(mark)
    header = content[:end].decode("ascii").split("\n")
    count = next(int(line.split()[2]) for line in header if line.startswith("element vertex"))
    fields = [line.split()[2] for line in header if line.startswith("property float ")]
    rows = np.frombuffer(content, np.dtype([(f, "<f4") for f in fields]), count, end)

    def columns(names: list[str]) -> np.ndarray:
        return np.stack([rows[name] for name in names], axis=1)

    def numbered(prefix: str) -> list[str]:
        return sorted((f for f in fields if f.startswith(prefix)), key=lambda f: int(f[len(prefix):]))

    quaternions = columns(numbered("rot_"))
    rest = numbered("f_rest_")
    sh = columns(numbered("f_dc_"))[:, None, :]
    if rest:
        # By channel, then by coefficient.
        higher = columns(rest).reshape(count, 3, len(rest) // 3)
        sh = np.concatenate([sh, np.moveaxis(higher, 1, 2)], axis=1)
    return Splat(
        means=columns(["x", "y", "z"]),
        scales=np.exp(columns(numbered("scale_"))),
        quaternions=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        opacities=1.0 / (1.0 + np.exp(-rows["opacity"])),
        sh=sh,
    )
