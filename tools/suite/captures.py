"""The captures of the suite: objects and their halves, motions, light, frame rates, lenses.

A capture is one name, `OBJECT-MOTION-LIGHT-FPS`, from which everything follows: what is drawn at
random is drawn with the name as seed.
"""

import hashlib
import json
import math
import os
from dataclasses import asdict, dataclass

import numpy as np

import motions

REVISION = 2  # to be raised when the same parameters give other pictures: results are made anew

# Half A may be used to choose rules and thresholds; half B never: it says how well they carry over.
HALVES = {
    "A": ["mockup", "aura", "iss", "statue", "microphone", "product"],
    "B": ["hubble", "landsat", "terra", "bust", "chair", "bottle"],
}
OBJECTS = HALVES["A"] + HALVES["B"]
MODELS = {  # glTF files below SHARED/data/spacecraft_glb
    "aura": "Aura.glb", "iss": "international_space_station_iss.glb", "hubble": "HUBBLE.glb",
    "landsat": "LANDSAT-7.glb", "terra": "Terra.glb",
}
# Greatest distance from the vertical axis, and from the plane across it, of the object inside a
# bounding sphere of 0.5 m; Source: measured on the meshes by web/page.js (`size`).
SIZES_M = {
    "mockup": (0.479, 0.236), "aura": (0.221, 0.468), "iss": (0.496, 0.100), "statue": (0.416, 0.461),
    "microphone": (0.243, 0.438), "product": (0.303, 0.399), "hubble": (0.499, 0.277), "landsat": (0.447, 0.244),
    "twins": (0.352, 0.356),
    "terra": (0.484, 0.170), "bust": (0.394, 0.461), "chair": (0.289, 0.422), "bottle": (0.150, 0.478),
}
MOTIONS = ["yaw", "hand", "tumble", "orbit", "walk", "few"]
TUMBLES = ["tumble", "swing"]
PHOTOS = ["orbit", "few"]  # motions that are photos: they have no frame rate
IN_A_ROOM = ["orbit", "walk", "few", "stage", "moved"]
# Photos for the made-wrong set alone: on a turntable before black, in a room that stands still, and
# an orbit in the middle of which the object was moved.
EXTRA_MOTIONS = ["stand", "stage", "moved"]
# Videos of turns and tumbles in which parts of the object turn on joints.
ARTICULATED = {"arrays": ["left array", "right array"], "swing": ["dish"]}
LIGHTS = ["low", "full", "sun"]
RATES = [4, 15, 30]

WIDTH, HEIGHT = 640, 480
TABLE_M = -0.62  # height of the table in the room; Source: web/places.js
RADIUS_M = 0.5  # of the object's bounding sphere
YAW_RATE_DEG_S = 10.0
HAND_S, TUMBLE_S, WALK_S = 12.0, 12.0, 12.0
ORBIT_STEP_DEG = 10.0
FEW = 10  # photos of `few`
MOST_ELEVATION_DEG = 14.0  # of a camera on a tripod above the object


@dataclass(frozen=True)
class Capture:
    """What is filmed, how it moves, under which light, at how many frames a second (0: photos)."""

    object: str
    motion: str
    light: str
    fps: int

    @property
    def name(self):
        return f"{self.object}-{self.motion}-{self.light}" + (f"-{self.fps}" if self.fps else "")

    @property
    def half(self):
        return next((h for h, names in HALVES.items() if self.object in names), "A")

    def key(self):
        """Hash of all that the pictures depend on."""
        text = json.dumps(asdict(self) | {"revision": REVISION}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    def rng(self, stream):
        """Random numbers of this capture; the same name gives the same numbers."""
        digest = hashlib.sha256(f"{self.name} {stream}".encode()).digest()
        return np.random.default_rng(list(digest[:16]))

    def folder(self, cache):
        return os.path.join(cache, "captures", f"{self.name}-{self.key()}")


def parse(name):
    """The capture of a name."""
    part = name.split("-")
    return Capture(part[0], part[1], part[2], int(part[3]) if len(part) > 3 else 0)


def all_captures():
    """Every capture of the suite."""
    return [Capture(o, m, light, fps) for o in OBJECTS for m in MOTIONS for light in LIGHTS
            for fps in ([0] if m in PHOTOS else RATES)]


# What is made first: each class once or twice, on four objects of half A and two of half B.
SMALL = [f"{o}-{kind}" for o in ("mockup", "aura", "statue", "product", "hubble", "chair")
         for kind in ("yaw-low-4", "yaw-full-4", "hand-full-15", "tumble-sun-15", "orbit-full")]


def selected(words, small=False):
    """Captures whose name contains one of the words; all of them where there are none."""
    pool = [parse(n) for n in SMALL] if small else all_captures()
    return [c for c in pool if not words or any(w in c.name for w in words)]


def extra(words):
    """Captures of the made-wrong set and articulated ones; only those that are asked for by their
    whole name."""
    named = [(w, w.split("-")) for w in words]
    return [parse(w) for w, part in named
            if len(part) == 3 and part[1] in EXTRA_MOTIONS or len(part) == 4 and part[1] in ARTICULATED]


def lens_of(capture):
    """A phone's camera: f, principal point, two radial distortion terms (COLMAP's RADIAL)."""
    rng = capture.rng("lens")
    return {"f": round(float(rng.uniform(480, 620)), 2), "cx": round(WIDTH / 2 + float(rng.uniform(-9, 9)), 2),
            "cy": round(HEIGHT / 2 + float(rng.uniform(-9, 9)), 2), "k1": round(float(rng.uniform(-0.06, 0.07)), 4),
            "k2": round(float(rng.uniform(-0.05, 0.02)), 4)}


def light_of(capture):
    """Strength of lamp and room, direction of the lamp, and the sensor that goes with it.

    The brightest hundredth of the object is exposed to `white`; full well and read noise in
    electrons.
    """
    rng = capture.rng("light")
    a, e = math.radians(rng.uniform(20, 55)) * rng.choice([-1, 1]), math.radians(rng.uniform(15, 45))
    direction = [math.cos(e) * math.sin(a), -math.cos(e) * math.cos(a), math.sin(e)]
    kinds = {
        "low": {"lamp": 0.1, "room": 0.6, "white": 0.22, "full_well": 1500, "read_noise": 4.0},
        "full": {"lamp": 1.0, "room": 0.6, "white": 0.85, "full_well": 6000, "read_noise": 3.0},
        "sun": {"lamp": 1.0, "room": 0.03, "white": 0.9, "full_well": 6000, "read_noise": 3.0},
    }
    light = kinds[capture.light] | {"sun": capture.light == "sun", "direction": direction}
    if light["sun"] and capture.motion in IN_A_ROOM:
        light["room"] = 0.15  # in a room walls throw light back
    return light


def lamp_of(capture):
    """Degrees to the right of a camera on a tripod, and above it, from which the lamp shines."""
    offset = float(np.linalg.norm(mount_of(capture)[:3, 3]))
    R, _ = still_camera(capture, distance_of(capture, lens_of(capture), offset))
    x, y, z = R @ np.array(light_of(capture)["direction"])
    return math.degrees(math.atan2(x, -z)), math.degrees(math.asin(-y / math.hypot(x, y, z)))


def ground_of(capture):
    """Green screen, black, or a room."""
    if capture.motion in IN_A_ROOM:
        return "room"
    return "black" if capture.motion in (*TUMBLES, "stand") or capture.light == "sun" else "green"


def distance_of(capture, lens, offset):
    """Distance (m) at which the object, `offset` off the origin, fills most of the picture.

    A turning object is a cylinder, others the bounding sphere.
    """
    room = [min(lens["cx"], WIDTH - lens["cx"]) / lens["f"], min(lens["cy"], HEIGHT - lens["cy"]) / lens["f"]]
    share = {"orbit": 0.66, "walk": 0.66, "few": 0.66, "moved": 0.6, "stage": 0.75}.get(capture.motion, 0.9)
    if capture.motion not in ("yaw", "hand", "stand", "arrays"):
        return (RADIUS_M + offset) / math.sin(math.atan(share * room[1]))
    flat, height = (x + offset for x in SIZES_M[capture.object])
    steep = math.radians(MOST_ELEVATION_DEG)
    aside = flat / math.sin(math.atan(share * room[0]))
    above = flat * math.cos(steep) + (height * math.cos(steep) + flat * math.sin(steep)) / (share * room[1])
    return max(aside, above)


def mount_of(capture):
    """Where the object sits in the body frame: 4x4, a little off the axis and tilted."""
    rng = capture.rng("mount")
    M = np.eye(4)
    if capture.motion in TUMBLES:
        M[:3, :3] = motions.random_rotation(rng)
        return M
    for axis, size in (([1, 0, 0], 3), ([0, 1, 0], 3), ([0, 0, 1], 180)):
        M[:3, :3] = motions.axis_angle(axis, math.radians(rng.uniform(-size, size))) @ M[:3, :3]
    M[:2, 3] = rng.uniform(-0.04, 0.04, 2)
    return M


def still_camera(capture, distance):
    """Pose camera_from_world of a camera on a tripod that looks a little down on the object."""
    rng = capture.rng("camera")
    e = math.radians(rng.uniform(3, MOST_ELEVATION_DEG))
    centre = distance * np.array([0, -math.cos(e), math.sin(e)])
    R = motions.look_at(centre, rng.uniform(-0.012, 0.012, 3), math.radians(rng.uniform(-2, 2)))
    return R, -R @ centre


def poses_of(capture, lens, mount):
    """World poses of every frame and the truth about the motion.

    Returns (list of world_from_body (R, t), list of camera_from_world (R, t), record).
    """
    offset = float(np.linalg.norm(mount[:3, 3]))
    distance = distance_of(capture, lens, offset)
    rng = capture.rng("motion")
    if capture.motion in ("walk", "few"):
        cameras = motions.hand_held_cameras(rng, capture.fps or FEW / WALK_S, WALK_S, distance)
        return [(np.eye(3), np.zeros(3))] * len(cameras), cameras, {"type": capture.motion}
    if capture.motion in ("orbit", "moved"):
        cameras = motions.orbit_cameras(rng, 36, ORBIT_STEP_DEG, distance, math.radians(rng.uniform(10, 25)))
        bodies = [(np.eye(3), np.zeros(3))] * len(cameras)
        if capture.motion == "moved":
            table = TABLE_M + SIZES_M[capture.object][1]
            bodies = [(np.eye(3), np.array([-0.1, 0.05, table]))] * 18
            bodies += [(motions.axis_angle([0, 0, 1], math.radians(70)), np.array([0.2, -0.15, table]))] * 18
        return bodies, cameras, {"type": capture.motion}
    camera = still_camera(capture, distance)
    if capture.motion in TUMBLES:
        bodies, record = tumbling(capture, rng, camera)
    else:
        bodies, record = turning(capture, rng, camera)
    return bodies, [camera] * len(bodies), record


def turning(capture, rng, camera):
    """A turn about the body's z axis: by a motor, or by hand."""
    sign = int(rng.choice([-1, 1]))
    if capture.motion in ("stand", "stage"):
        angles, record = ORBIT_STEP_DEG * np.arange(36), {"type": "turntable"}
    elif capture.motion in ("yaw", "arrays"):
        angles = motions.yaw_angles(YAW_RATE_DEG_S, capture.fps)
        record = {"type": "steady turn", "rate_deg_s": sign * YAW_RATE_DEG_S}
    else:
        total = float(rng.uniform(350, 400))
        angles = motions.hand_angles(rng, capture.fps, HAND_S, total)
        record = {"type": "turn by hand", "total_deg": total, "overlap_deg": total - 360}
    axis = sign * (camera[0] @ [0, 0, 1])
    record |= {"axis_body": [0, 0, sign], "axis_camera": axis.tolist(), "angles_deg": angles.tolist()}
    return [(motions.axis_angle([0, 0, sign], math.radians(a)), np.zeros(3)) for a in angles], record


def joints_of(capture, count):
    """Angles (degrees) of the object's joints in each frame, 0 at the start, by name.

    Arrays turn by 120 degrees in all, steadily or slowly at either end; a dish swings 20 degrees to
    either side.
    """
    rng, joints = capture.rng("joints"), {}
    s = np.arange(count) / count
    for name in ARTICULATED.get(capture.motion, []):
        if capture.motion == "arrays":
            angles = 120 * (s if rng.random() < 0.5 else 0.5 - 0.5 * np.cos(math.pi * s))
        else:
            angles = 20 * np.sin(2 * math.pi * s * rng.uniform(0.8, 1.6))
        joints[name] = {"angles_deg": (rng.choice([-1, 1]) * angles).tolist()}
    return joints


def tumbling(capture, rng, camera):
    """Torque-free motion about the origin of the body frame, whose axes are the principal ones."""
    inertia = np.array([1.0, rng.uniform(0.72, 0.9), rng.uniform(0.4, 0.62)])
    lean = math.radians(rng.uniform(15, 35))  # of the rates from the principal axis they go about
    about = 0 if rng.random() < 0.5 else 2  # largest or least inertia: both are stable
    other = rng.uniform(0, 2 * math.pi)
    w = np.zeros(3)
    w[about] = math.cos(lean)
    w[[k for k in range(3) if k != about]] = math.sin(lean) * np.array([math.cos(other), math.sin(other)])
    w *= math.radians(rng.uniform(32, 48))
    q0 = motions.matrix_quaternion(motions.random_rotation(rng))
    q, rates = motions.tumble(inertia, w, q0, capture.fps, TUMBLE_S)
    momentum = motions.quaternion_matrix(q[0]) @ (inertia * rates[0])
    principal = np.array([motions.quaternion_matrix(x)[:, about] for x in q])
    nutation = np.degrees(np.arccos(np.clip(principal @ momentum / np.linalg.norm(momentum), -1, 1)))
    record = {
        "type": "tumble", "inertia": inertia.tolist(), "about_principal_axis": about,
        "rates_body_deg_s": np.degrees(rates).tolist(), "rate_deg_s": float(np.degrees(np.linalg.norm(rates, axis=1)).mean()),
        "momentum_world": (momentum / np.linalg.norm(momentum)).tolist(),
        "momentum_camera": (camera[0] @ momentum / np.linalg.norm(momentum)).tolist(),
        "nutation_deg": [float(nutation.min()), float(nutation.max())],
        "polhode_period_s": motions.polhode_period(inertia, w),
    }
    return [(motions.quaternion_matrix(x), np.zeros(3)) for x in q], record
