"""How object and camera move in a capture of the suite: poses from numbers alone.

Frames (those of the whole project): the body frame turns with the object, its origin on the axis
(or in the centre of mass), metres, +z up at rest; the world frame does not turn; the camera frame
has x right, y down, z forward. A pose (R, t) takes points from one frame to another: y = R x + t.
"""

import math

import numpy as np

STEP_S = 1e-3  # step at which a rate of turning is added up, seconds
TUMBLE_STEP_S = 5e-3  # Source: the error of RK4 at 1 rad/s stays below 1e-9 rad in 12 s


def axis_angle(axis, angle):
    """Rotation matrix about an axis by an angle in radians (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def random_rotation(rng):
    """A rotation matrix drawn evenly from all rotations."""
    q = rng.normal(size=4)
    return quaternion_matrix(q / np.linalg.norm(q))


def quaternion_matrix(q):
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def matrix_quaternion(R):
    """Unit quaternion (w, x, y, z), w >= 0: largest eigenvector of Bar-Itzhack's matrix."""
    K = np.array([
        [R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
        [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
        [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], np.trace(R)]])
    x, y, z, w = np.linalg.eigh(K)[1][:, -1]
    return np.array([w, x, y, z]) * (1 if w >= 0 else -1)


def look_at(centre, target, roll=0.0):
    """Rotation camera_from_world of a camera at `centre` that looks at `target`; radians."""
    z = np.asarray(target, float) - centre
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return axis_angle([0, 0, 1], roll) @ np.array([x, np.cross(z, x), z])


def smooth_walk(rng, n, waves):
    """A smooth random curve of size about 1 at n points: `waves` sines of random phase."""
    s = np.linspace(0, 2 * math.pi, n)
    terms = [rng.normal() / k * np.sin(0.5 * k * s + rng.uniform(0, 2 * math.pi)) for k in range(1, waves + 1)]
    return np.sum(terms, axis=0)


def yaw_angles(rate_deg_s, fps, total_deg=360.0):
    """Angles (degrees) of a steady turn; the frame after the last would be at `total_deg`."""
    n = round(total_deg / rate_deg_s * fps)
    return rate_deg_s / fps * np.arange(n)


def hand_angles(rng, fps, duration_s, total_deg, ripple=0.2, stop=0.95):
    """Angles (degrees) of a turn by hand, 0 in the first frame and `total_deg` in the last.

    The rate ripples by `ripple` of its mean (peak), and once it falls by `stop` for about half a
    second.
    """
    t = np.arange(0, duration_s + STEP_S, STEP_S)
    wave = sum(rng.uniform(0.4, 1) * np.sin(2 * math.pi * f * t + rng.uniform(0, 2 * math.pi))
               for f in rng.uniform(0.15, 0.9, 4))
    rate = 1 + ripple * wave / np.abs(wave).max()
    at = duration_s * rng.uniform(0.25, 0.75)
    rate *= 1 - stop * np.exp(-((t - at) / 0.35) ** 2)
    angle = np.concatenate([[0], np.cumsum((rate[1:] + rate[:-1]) / 2 * STEP_S)])
    frames = np.arange(round(duration_s * fps)) / fps
    sampled = np.interp(frames, t, angle)
    return total_deg * sampled / sampled[-1]


def euler_rates(inertia, w):
    """dw/dt of a torque-free rigid body, principal axes: I dw/dt = -w x (I w)."""
    return -np.cross(w, inertia * w) / inertia


def quaternion_times(a, b):
    """Hamilton product."""
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def tumble(inertia, w0, q0, fps, duration_s, step_s=TUMBLE_STEP_S):
    """Torque-free motion by Runge-Kutta of order four.

    Returns attitudes world_from_principal [n, 4] (unit quaternions) and rates [n, 3] (rad/s, in
    principal axes) at the frames' times k / fps.
    """
    inertia = np.asarray(inertia, float)
    state = np.concatenate([q0, w0])

    def slope(s):
        return np.concatenate([0.5 * quaternion_times(s[:4], np.array([0.0, *s[4:]])), euler_rates(inertia, s[4:])])

    n = round(duration_s * fps)
    inner = max(1, math.ceil(1 / fps / step_s))
    h = 1 / fps / inner
    states = [state]
    for _ in range(n - 1):
        for _ in range(inner):
            a = slope(state)
            b = slope(state + h / 2 * a)
            c = slope(state + h / 2 * b)
            d = slope(state + h * c)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
            state[:4] /= np.linalg.norm(state[:4])
        states.append(state)
    states = np.array(states)
    return states[:, :4], states[:, 4:]


def polhode_period(inertia, w0):
    """Seconds after which the rates in principal axes repeat (Landau & Lifshitz, section 37).

    Inertia ascending or descending; arithmetic-geometric mean for the elliptic integral K.
    """
    order = np.argsort(inertia)
    I1, I2, I3 = np.asarray(inertia, float)[order]
    w = np.asarray(w0, float)[order]
    energy2, momentum2 = float([I1, I2, I3] @ w**2), float(np.array([I1, I2, I3]) ** 2 @ w**2)
    if momentum2 < energy2 * I2:  # about the axis of least inertia: exchange the roles
        I1, I3 = I3, I1
    k2 = (I2 - I1) * (energy2 * I3 - momentum2) / ((I3 - I2) * (momentum2 - energy2 * I1))
    a, b = 1.0, math.sqrt(max(1e-300, 1 - k2))
    for _ in range(40):
        a, b = (a + b) / 2, math.sqrt(a * b)
    K = math.pi / (2 * a)
    return 4 * K * math.sqrt(I1 * I2 * I3 / ((I3 - I2) * (momentum2 - energy2 * I1)))


def orbit_cameras(rng, n, step_deg, distance, elevation):
    """Poses camera_from_world of a camera carried round a circle, a little unsteady."""
    hand = [smooth_walk(rng, n, 9) for _ in range(6)]
    poses = []
    for k in range(n):
        azimuth = math.radians(step_deg) * k + math.radians(0.4) * hand[0][k]
        e, d = elevation + 0.01 * hand[1][k], distance * (1 + 0.008 * hand[2][k])
        centre = d * np.array([math.cos(e) * math.sin(azimuth), -math.cos(e) * math.cos(azimuth), math.sin(e)])
        aim = 0.012 * np.array([hand[3][k], 0, hand[4][k]])
        R = look_at(centre, aim, math.radians(1.0 * hand[5][k]))
        poses.append((R, -R @ centre))
    return poses


def hand_held_cameras(rng, fps, duration_s, distance):
    """Poses camera_from_world of a walk most of the way round, height and distance changing."""
    n = round(fps * duration_s)
    t = np.arange(n) / fps
    m = max(400, n)
    hand = [np.interp(t, np.linspace(0, duration_s, m), smooth_walk(rng, m, waves)) for waves in (5, 5, 4, 8, 8, 6)]
    sweep = math.radians(rng.uniform(230, 340)) * rng.choice([-1, 1])
    poses = []
    for k in range(n):
        azimuth = sweep * t[k] / duration_s + 0.15 * hand[0][k]
        e = 0.3 + 0.18 * math.tanh(hand[1][k])
        d = distance * (1 + 0.12 * math.tanh(hand[2][k]))
        centre = d * np.array([math.cos(e) * math.sin(azimuth), -math.cos(e) * math.cos(azimuth), math.sin(e)])
        aim = 0.04 * np.array([hand[3][k], 0, hand[4][k]])
        R = look_at(centre, aim, 0.06 * hand[5][k])
        poses.append((R, -R @ centre))
    return poses
