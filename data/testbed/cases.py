"""The captures of the test bed as plain numbers: cameras, paths, light and sensor.

No Blender here: the renderer (`render.py`) and the camera model (`develop.py`) both read
their poses from this file, so what is written as truth is what was rendered.

Conventions (those of the whole project)
    satellite frame   right-handed, metres, +z up along the yaw axis, the origin on the axis.
                      The mock-up sits a little off this axis (`MOUNT`).
    camera frame      x right, y down, z forward; pose = camera_from_satellite: x_c = R x_s + t
    pixel             (0, 0) is the corner of the image, the first pixel's centre is (0.5, 0.5)
    radial model      x_d = x (1 + k1 r^2 + k2 r^4), r^2 = |x|^2, x = (X/Z, Y/Z); pixel = f x_d + c
"""

from dataclasses import dataclass
import math

import numpy as np

# Where the mock-up sits in the satellite frame: metres and degrees (rotations about x, y, z).
MOUNT_M = (0.035, -0.022, 0.0)
MOUNT_DEG = (2.0, -1.5, 8.0)


@dataclass(frozen=True)
class Lens:
    """A phone's camera: focal length and principal point in pixels, radial distortion."""

    width: int
    height: int
    f: float
    cx: float
    cy: float
    k1: float
    k2: float = 0.0

    def colmap(self):
        """The line of COLMAP's cameras.txt after the camera's number."""
        if self.k2 == 0.0:
            return f"SIMPLE_RADIAL {self.width} {self.height} {self.f} {self.cx} {self.cy} {self.k1}"
        return f"RADIAL {self.width} {self.height} {self.f} {self.cx} {self.cy} {self.k1} {self.k2}"


@dataclass(frozen=True)
class Shot:
    """What Blender renders: a place, a path and a lens. One shot serves several cases, for
    the lamp and the room's own light are stored apart and mixed afterwards."""

    name: str
    room: str  # a function of rooms.py
    path: str  # orbit | yaw | hand
    frames: int
    lens: Lens
    distance_m: float  # camera to axis
    height_m: float  # camera above the origin
    shutter: float = 0.0  # exposure as a part of the frame interval (0: no motion blur)
    shake: float = 1.0  # how unsteady the hand is; 0: tripod
    samples: int = 12
    bounces: int = 2
    clamp: float = 1.0  # of indirect light: no fireflies, a little less light
    density: float = 1.15  # rendered pixels per camera pixel
    # The picture may be rendered in layers, for most of the light's work is in the satellite:
    # `whole`: no layers; `moving`: satellite and room apart; `static`: the room once, without
    # satellite, times its change of light in each frame at `back_density`.
    layers: str = "whole"
    back_samples: int = 6
    back_density: float = 1.0
    clean_samples: int = 24


@dataclass(frozen=True)
class Case:
    """A capture: a shot under a certain light, seen by a certain sensor."""

    name: str
    shot: str
    lamp: float  # lamp's strength, 1 = 100 %
    room: float  # strength of all other light
    exposure: float  # gain on linear light
    full_well: float  # photo-electrons at white
    read_noise: float  # electrons
    video_fps: float = 0.0  # 0: stills
    crf: int = 20
    truth_every: int = 1  # mattes are written for every k-th frame
    depth_every: int = 9


VIDEO_LENS = Lens(640, 480, 520.0, 327.4, 234.1, 0.05, -0.04)
STILL_LENS = Lens(640, 480, 531.5, 314.3, 246.2, 0.042, -0.05)
DEMO_LENS = Lens(480, 360, 400.0, 243.1, 177.2, -0.03)

SHOTS = {
    s.name: s
    for s in (
        Shot("demo", "lit_room", "orbit", 72, DEMO_LENS, 1.45, 0.50, samples=6, bounces=1, clamp=3.0, density=1.0),
        Shot("orbit", "dark_room", "orbit", 36, STILL_LENS, 2.5, 0.55, layers="moving", samples=16,
             back_samples=5, back_density=0.8),
        Shot("yaw", "green_screen", "yaw", 216, VIDEO_LENS, 1.524, 0.20, shutter=0.12, shake=0.0, layers="static",
             samples=20, density=1.05, back_samples=16, back_density=0.3, clean_samples=64),
        # The phones of the other shots in a lit room: what calibrates them.
        Shot("hand_stills", "lit_room", "hand", 32, STILL_LENS, 1.6, 0.45, samples=8, bounces=1, clamp=3.0, density=1.0),
        Shot("hand_video", "lit_room", "hand", 32, VIDEO_LENS, 1.6, 0.45, samples=8, bounces=1, clamp=3.0, density=1.0),
    )
}

CASES = {
    c.name: c
    for c in (
        Case("demo", "demo", 1.0, 1.0, 1.0, 12000, 3.0, video_fps=12.0, crf=22),
        Case("case1", "orbit", 0.1, 1.0, 2.0, 1500, 4.0),
        Case("case2", "orbit", 1.0, 1.0, 1.0, 6000, 3.0),
        Case("case3", "yaw", 0.1, 0.6, 2.0, 1500, 4.0, video_fps=6.0, crf=23),
        Case("case4", "yaw", 1.0, 0.6, 1.0, 6000, 3.0, video_fps=6.0),
        Case("calibration_stills", "hand_stills", 1.0, 1.0, 1.0, 12000, 3.0),
        Case("calibration_video", "hand_video", 1.0, 1.0, 1.0, 12000, 3.0),
    )
}


def rotation(axis, angle):
    """Rotation matrix about 'x', 'y' or 'z'; radians."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array(
        {
            "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
            "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
            "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
        }[axis],
        dtype=float,
    )


def sway(i, n, seed):
    """A smooth closed curve of size about 1: the unsteadiness of hands and motors."""
    rng = np.random.default_rng(seed)
    a = 2 * math.pi * i / n
    return sum(rng.normal() / k * math.sin(k * a + rng.uniform(0, 2 * math.pi)) for k in (2, 3, 5, 7))


def yaw_angle(shot, i):
    """Turn of the satellite in frame i; radians, 0 in frame 0. One full turn in `shot.frames`
    frames; the rate is not quite even: up to 0.02 degrees away from a steady turn."""
    wobble = math.radians(0.1) * (sway(i, shot.frames, 7) - sway(0, shot.frames, 7))
    return 2 * math.pi * i / shot.frames + wobble


def look_at(centre, target, roll):
    """camera_from_world rotation of a camera at `centre` that looks at `target`."""
    z = target - centre
    z = z / np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    return rotation("z", roll) @ np.array([x, np.cross(z, x), z])


def camera_from_world(shot, i):
    """Camera pose in the room; the satellite's axis is the room's z axis. (R, t)"""
    if shot.path == "hand":
        return by_hand(shot, i)
    j, n = (i, shot.frames) if shot.path == "orbit" else (0, 1)
    azimuth = 2 * math.pi * j / n
    hand = [shot.shake * sway(j, n, seed) for seed in range(6)]
    azimuth += math.radians(0.35) * hand[0]
    radius = shot.distance_m * (1 + 0.006 * hand[1])
    height = shot.height_m * (1 + 0.02 * hand[2])
    flat = math.sqrt(radius**2 - height**2)
    centre = np.array([flat * math.sin(azimuth), -flat * math.cos(azimuth), height])
    aim = np.array([0.015 * hand[3], 0.0, 0.015 * hand[4]]) + [0.0, 0.0, -0.02]
    R = look_at(centre, aim, math.radians(0.9 * hand[5] + 0.7))
    return R, -R @ centre


def by_hand(shot, i):
    """Two walks most of the way round, the second with the phone higher and on its side. (R, t)"""
    half = shot.frames // 2
    second, j = divmod(i, half)
    hand = [shot.shake * sway(i, shot.frames, seed) for seed in range(6)]
    azimuth = 2 * math.pi * 0.85 * j / half
    height = shot.height_m + 0.5 * second + 0.08 * hand[0]
    radius = shot.distance_m * (1 + 0.06 * hand[1])
    flat = math.sqrt(radius**2 - height**2)
    centre = np.array([flat * math.sin(azimuth), -flat * math.cos(azimuth), height])
    aim = 0.05 * np.array([hand[2], hand[3], hand[4]])
    R = look_at(centre, aim, math.pi / 2 * second + 0.06 * hand[5])
    return R, -R @ centre


def camera_from_satellite(shot, i):
    """The truth: (R, t) of frame i in the satellite frame."""
    R, t = camera_from_world(shot, i)
    if shot.path == "yaw":
        R = R @ rotation("z", yaw_angle(shot, i))
    return R, t


def render_size(shot, density):
    """Size and focal length of the wider, undistorted picture that Blender renders.

    Its principal point is its middle. It must hold every ray of the distorted picture, so
    the corners and edges are undistorted and the farthest decides."""
    lens = shot.lens
    edge = np.linspace(0, 1, 65)
    u = np.concatenate([edge * lens.width, edge * lens.width, 0 * edge, 0 * edge + lens.width])
    v = np.concatenate([0 * edge, 0 * edge + lens.height, edge * lens.height, edge * lens.height])
    x, y = undistort(lens, u, v)
    f = lens.f * density
    width = 2 * math.ceil(f * np.abs(x).max() + 2)
    height = 2 * math.ceil(f * np.abs(y).max() + 2)
    return width, height, f


def layers(shot):
    """The layers to render: {folder: (first frames, samples, density)}."""
    n = shot.frames
    front = {"front": (n, shot.samples, shot.density)}
    back = {"back": (n, shot.back_samples, shot.back_density)}
    if shot.layers == "whole":
        return {"whole": (n, shot.samples, shot.density)}
    if shot.layers == "moving":
        return {**front, **back}
    # `base` is `back` without the satellite, with the same random numbers: their ratio is
    # noiseless where the satellite changes nothing.
    base = {"base": (1, shot.back_samples, shot.back_density)}
    return {**front, "clean": (1, shot.clean_samples, shot.density), **base, **back}


def undistort(lens, u, v):
    """Pixels to rays (X/Z, Y/Z) by fixed-point iteration; exact to 1e-12 for slight distortion."""
    xd, yd = (u - lens.cx) / lens.f, (v - lens.cy) / lens.f
    x, y = xd.copy(), yd.copy()
    for _ in range(40):
        r2 = x * x + y * y
        gain = 1 + lens.k1 * r2 + lens.k2 * r2 * r2
        x, y = xd / gain, yd / gain
    return x, y


def project(lens, R, t, points):
    """Points [N,3] of the satellite frame to pixels [N,2] and depths [N]."""
    p = points @ R.T + t
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r2 = x * x + y * y
    gain = 1 + lens.k1 * r2 + lens.k2 * r2 * r2
    return np.stack([lens.f * x * gain + lens.cx, lens.f * y * gain + lens.cy], 1), p[:, 2]
