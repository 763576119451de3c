#!/usr/bin/env python3
"""Judges the poses of a turntable: how far its angles, its axis and its cameras are from the truth.

    turntable.py MODEL... --truth FOLDER        COLMAP models, binary or text; the truth likewise
    turntable.py MODEL...                       no truth: the angles between neighbours by name
    turntable.py --self-test

For each model one line of JSON. Needs nothing beside Python's standard library, shares no code with
what it judges.
    angle_rms_deg   root mean square of (angle found - true angle) over the images, the mean taken out: the angle
                    about the model's own axis; where angle 0 lies is nobody's business
    axis_tilt_deg   between the axes of rotation in the camera's frame
    axis_spread_deg root mean square of what the poses turn beside the one axis (0: a pure turn)
    centre_*_pct    distance of camera centres after a least-squares similarity (Horn 1987), in percent of the radius
    closing_deg     error of the angle between the first and the last image
    step_*_deg      mean and standard deviation of the steps between neighbours, the last and the first among them
    period_deg      amplitudes of the error's first three harmonics over the true angle
Images are matched by name without extension; with --by-suffix by what follows the first "-" of a
name (shuffled copies).
"""
import argparse
import json
import math
import os
import struct
import sys


def rotation(q):
    w, x, y, z = q
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def times(a, b):
    """Hamilton product of quaternions (w, x, y, z)."""
    return (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])


def inverse(q):
    return (q[0], -q[1], -q[2], -q[3])


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def centre(q, t):
    """-R^T t."""
    R = rotation(q)
    return [-sum(R[k][i] * t[k] for k in range(3)) for i in range(3)]


def model_folder(path):
    """The folder with the images' poses: PATH, or sparse/0 in it, or the fullest numbered model."""
    has = lambda p: any(os.path.isfile(os.path.join(p, "images" + e)) for e in (".bin", ".txt"))
    inside = [path, os.path.join(path, "sparse")]
    for folder in inside:
        if has(folder):
            return folder
        numbered = [os.path.join(folder, n) for n in sorted(os.listdir(folder))] if os.path.isdir(folder) else []
        numbered = [p for p in numbered if has(p)]
        if numbered:
            return max(numbered, key=lambda p: len(read_poses(p)))
    raise SystemExit(f"no COLMAP model in {path}")


def read_poses(folder):
    """{name without extension: (quaternion, translation)}, camera from world."""
    poses = {}
    binary = os.path.join(folder, "images.bin")
    if os.path.isfile(binary):
        with open(binary, "rb") as file:
            data = file.read()
        (count,), at = struct.unpack_from("<Q", data), 8
        for _ in range(count):
            numbers = struct.unpack_from("<i7di", data, at)
            end = data.index(b"\0", at + 64)
            name = data[at + 64:end].decode()
            (points,) = struct.unpack_from("<Q", data, end + 1)
            at = end + 9 + 24 * points
            poses[os.path.splitext(name)[0]] = (numbers[1:5], numbers[5:8])
        return poses
    with open(os.path.join(folder, "images.txt")) as file:
        lines = [line.rstrip("\n") for line in file if not line.startswith("#")]
    for line in lines[::2]:
        if line.strip():
            part = line.split()
            numbers = [float(x) for x in part[1:8]]
            poses[os.path.splitext(part[9])[0]] = (tuple(numbers[:4]), tuple(numbers[4:]))
    return poses


def common_axis(relative):
    """The direction most vector parts of rotations are along: dominant eigenvector of their sum of
    squares."""
    S = [[sum(q[1 + i] * q[1 + k] for q in relative) for k in range(3)] for i in range(3)]
    for _ in range(12):  # squaring: the dominant direction is left
        n = max(abs(x) for row in S for x in row)
        S = [[sum(S[i][j] * S[j][k] for j in range(3)) / n / n for k in range(3)] for i in range(3)]
    a = max(S, key=lambda row: dot(row, row))
    n = math.sqrt(dot(a, a))
    return [x / n for x in a]


def turn(poses, names):
    """(axis in the camera's frame, angle of each image in degrees, spread of the rotations beside
    the axis)."""
    first = inverse(poses[names[0]][0])
    about = [times(poses[n][0], first) for n in names]  # camera from camera of the first image
    axis = common_axis(about)
    angles = [2 * math.degrees(math.atan2(dot(axis, q[1:]), q[0])) for q in about]
    beside = []
    for q in about:
        along = dot(axis, q[1:])
        beside.append(2 * math.degrees(math.asin(min(1.0, math.sqrt(max(0.0, dot(q[1:], q[1:]) - along * along))))))
    return axis, angles, math.sqrt(sum(b * b for b in beside) / len(beside))


def wrapped(degrees):
    return (degrees + 180) % 360 - 180


def similarity_errors(found, true):
    """Distances of `found` from `true` after the best similarity (Horn 1987: the largest
    eigenvalue's quaternion)."""
    n = len(found)
    mf, mt = ([sum(p[i] for p in points) / n for i in range(3)] for points in (found, true))
    F, T = ([[p[i] - m[i] for i in range(3)] for p in points] for points, m in ((found, mf), (true, mt)))
    M = [[sum(f[i] * t[k] for f, t in zip(F, T)) for k in range(3)] for i in range(3)]
    N = [[M[0][0] + M[1][1] + M[2][2], M[1][2] - M[2][1], M[2][0] - M[0][2], M[0][1] - M[1][0]],
         [0, M[0][0] - M[1][1] - M[2][2], M[0][1] + M[1][0], M[2][0] + M[0][2]],
         [0, 0, M[1][1] - M[0][0] - M[2][2], M[1][2] + M[2][1]], [0, 0, 0, M[2][2] - M[0][0] - M[1][1]]]
    N = [[N[min(i, k)][max(i, k)] for k in range(4)] for i in range(4)]
    shift = max(sum(abs(x) for x in row) for row in N)
    q = [1.0, 0.3, 0.2, 0.1]
    P = [[N[i][k] + (shift if i == k else 0) for k in range(4)] for i in range(4)]
    for _ in range(40):  # squaring
        n2 = max(abs(x) for row in P for x in row)
        P = [[sum(P[i][j] * P[j][k] for j in range(4)) / n2 / n2 for k in range(4)] for i in range(4)]
    q = max(P, key=lambda row: dot(row, row))
    R = rotation(q)
    turned = [[dot(R[i], f) for i in range(3)] for f in F]
    scale = sum(dot(a, t) for a, t in zip(turned, T)) / sum(dot(f, f) for f in F)
    return [math.dist([scale * x for x in a], t) for a, t in zip(turned, T)]


def harmonics(errors, true):
    """Amplitudes of the first three harmonics of the errors over the true angle (least squares on a
    full turn)."""
    n = len(errors)
    return [2 / n * math.hypot(sum(e * math.cos(k * math.radians(a)) for e, a in zip(errors, true)),
                               sum(e * math.sin(k * math.radians(a)) for e, a in zip(errors, true))) for k in (1, 2, 3)]


def judge(model, truth, total):
    """Figures of a model's poses against the truth's."""
    names = [n for n in truth if n in model]
    record = dict(registered=len(names), total=total)
    if len(names) < 3:
        return record, []
    axis, angles, spread = turn(model, names)
    true_axis, true_angles, _ = turn(truth, names)
    if dot(axis, true_axis) < 0:
        axis, angles = [-x for x in axis], [-a for a in angles]
    errors = [wrapped(a - b) for a, b in zip(angles, true_angles)]
    mean = sum(errors) / len(errors)
    errors = [e - mean for e in errors]
    centres = [[centre(*poses[n]) for n in names] for poses in (model, truth)]
    radius = circle_radius(centres[1], true_axis, truth[names[0]])
    off = sorted(100 * e / radius for e in similarity_errors(*centres))
    cross = [true_axis[1] * axis[2] - true_axis[2] * axis[1], true_axis[2] * axis[0] - true_axis[0] * axis[2],
             true_axis[0] * axis[1] - true_axis[1] * axis[0]]
    record |= dict(
        angle_rms_deg=math.sqrt(sum(e * e for e in errors) / len(errors)), angle_max_deg=max(abs(e) for e in errors),
        axis_tilt_deg=math.degrees(math.asin(min(1.0, math.sqrt(dot(cross, cross))))), axis_spread_deg=spread,
        centre_median_pct=off[len(off) // 2], centre_rms_pct=math.sqrt(sum(e * e for e in off) / len(off)), centre_max_pct=off[-1],
        closing_deg=errors[-1] - errors[0], period_deg=harmonics(errors, true_angles))
    return record, list(zip(names, true_angles, errors))


def circle_radius(centres, axis, pose):
    """Distance of the cameras from the axis: `axis` is in the camera's frame, so it is turned into
    the world first."""
    R = rotation(pose[0])
    a = [sum(R[k][i] * axis[k] for k in range(3)) for i in range(3)]
    flat = [[c[i] - dot(a, c) * a[i] for i in range(3)] for c in centres]
    # Of a circle: the point whose squared distances to all centres differ least (linear least
    # squares, Kasa 1976).
    u = max(([1, 0, 0], [0, 1, 0], [0, 0, 1]), key=lambda e: 1 - dot(e, a) ** 2)
    u = [u[i] - dot(u, a) * a[i] for i in range(3)]
    n = math.sqrt(dot(u, u))
    u = [x / n for x in u]
    v = [a[1] * u[2] - a[2] * u[1], a[2] * u[0] - a[0] * u[2], a[0] * u[1] - a[1] * u[0]]
    rows = [(dot(c, u), dot(c, v)) for c in flat]
    mx, my = (sum(r[i] for r in rows) / len(rows) for i in (0, 1))
    rows = [(x - mx, y - my) for x, y in rows]
    A = [[sum(r[i] * r[k] for r in rows) for k in (0, 1)] for i in (0, 1)]
    b = [0.5 * sum(r[i] * (r[0] ** 2 + r[1] ** 2) for r in rows) for i in (0, 1)]
    d = A[0][0] * A[1][1] - A[0][1] * A[1][0]
    x, y = (b[0] * A[1][1] - b[1] * A[0][1]) / d, (A[0][0] * b[1] - A[1][0] * b[0]) / d
    return math.sqrt(x * x + y * y + (A[0][0] + A[1][1]) / len(rows))


def steps(model, by_suffix):
    """Mean and standard deviation of the angles between images that are neighbours by name."""
    key = (lambda n: n.split("-", 1)[-1]) if by_suffix else (lambda n: n)
    names = sorted(model, key=key)
    axis, angles, spread = turn(model, names)
    sizes = [wrapped(b - a) for a, b in zip(angles, angles[1:] + angles[:1])]
    sign = math.copysign(1, sum(sizes))
    sizes = [sign * s for s in sizes]
    mean = sum(sizes) / len(sizes)
    sd = math.sqrt(sum((s - mean) ** 2 for s in sizes) / len(sizes))
    return dict(registered=len(names), step_mean_deg=mean, step_sd_deg=sd, axis_spread_deg=spread)


def self_test():
    """A known turn, disturbed by known amounts, must be judged by them."""
    def about_z(angle):
        return (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))

    def poses(tilt, error, scale):
        base = times((math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0), (0.65, 0.756, 0.05, 0.01))
        n = math.sqrt(sum(x * x for x in base))
        base = tuple(x / n for x in base)
        return {f"{i:03d}": (times(base, about_z(math.radians(10 * i) + error(i))), (0.0, -0.02 * scale, 1.5 * scale))
                for i in range(36)}

    truth = poses(0.0, lambda i: 0.0, 1.0)
    same, _ = judge(poses(0.0, lambda i: 0.3, 7.0), truth, 36)
    assert same["angle_rms_deg"] < 1e-9 and same["axis_tilt_deg"] < 1e-5 and same["centre_max_pct"] < 1e-6, same
    wave = math.radians(0.1)
    waved, _ = judge(poses(math.radians(0.4), lambda i: wave * math.sin(math.radians(20 * i)), 1.0), truth, 36)
    assert abs(waved["angle_rms_deg"] - 0.1 / math.sqrt(2)) < 1e-6, waved
    assert abs(waved["axis_tilt_deg"] - 0.4) < 0.02 and abs(waved["period_deg"][1] - 0.1) < 1e-6, waved
    plain = steps(truth, False)
    assert abs(plain["step_mean_deg"] - 10) < 1e-9 and plain["step_sd_deg"] < 1e-9, plain


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*")
    parser.add_argument("--truth")
    parser.add_argument("--by-suffix", action="store_true")
    parser.add_argument("--errors", help="write name, true angle, error of each image to this file")
    parser.add_argument("--self-test", action="store_true")
    args = parser.parse_args()
    if args.self_test:
        self_test()
    truth = args.truth and read_poses(model_folder(args.truth))
    for path in args.models:
        model = read_poses(model_folder(path))
        if truth:
            record, errors = judge(model, truth, len(truth))
            if args.errors:
                with open(args.errors, "w") as file:
                    file.writelines(f"{name} {angle:.6f} {error:.6f}\n" for name, angle, error in errors)
        else:
            record = steps(model, args.by_suffix)
        print(json.dumps(record))


if __name__ == "__main__":
    sys.exit(main())
