"""Tables of the pose solver: the shuffled dinosaur, simulated rings, speed against accuracy.
Called by bench.py."""
import json
import math
import os
import random
import shutil

from bench_results import STEPS

# CPU seconds and AUC@1 of COLMAP on temple_ring: 4.2.1 and its variants on another two-core machine
# with AVX-512
# (pycolmap from PyPI, defaults), 3.8 as Debian ships it.
PEERS = [
    ("COLMAP 3.8", 120, 17), ("COLMAP 4.2.1", 35, 17), ("COLMAP 4.2.1, global", 47, 19),
    ("COLMAP 4.2.1, principal point refined", 37, 70), ("COLMAP 4.2.1, sequential", 24, 13),
]


def read_text_model(folder):
    """Poses (R rows, t), pixels and point numbers by image name, and points, of a COLMAP text
    model."""
    def rows(name):
        with open(os.path.join(folder, name)) as file:
            return [line.rstrip("\n") for line in file if not line.startswith("#")]
    images = {}
    lines = rows("images.txt")
    for head, observations in zip(lines[::2], lines[1::2]):
        part = head.split()
        w, x, y, z = map(float, part[1:5])
        rotation = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
        values = observations.split()
        seen = {int(p): (float(u), float(v)) for u, v, p in zip(values[::3], values[1::3], values[2::3]) if p != "-1"}
        images[part[9]] = (rotation, list(map(float, part[5:8])), seen)
    return images


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def fundamental(p, q):
    """F with x_qᵀ F x_p = 0 of two 3 × 4 matrices: F_ij is a determinant of two rows of each
    (Hartley & Zisserman, 17.3)."""
    def det4(m):
        total = 0.0
        for c in range(4):
            minor = [[row[k] for k in range(4) if k != c] for row in m[1:]]
            total += (-1) ** c * m[0][c] * dot(minor[0], cross(minor[1], minor[2]))
        return total
    rest = [(1, 2), (2, 0), (0, 1)]
    return [[det4([p[j] for j in rest[i]] + [q[j] for j in rest[k]]) for i in range(3)] for k in range(3)]


def symmetric_error(f, x, y):
    """Mean of the distances of both points from each other's epipolar lines, pixels."""
    a, b = [*x, 1.0], [*y, 1.0]
    line_b = [dot(row, a) for row in f]
    line_a = [sum(f[k][i] * b[k] for k in range(3)) for i in range(3)]
    c = abs(dot(b, line_b))
    return 0.5 * (c / math.hypot(*line_b[:2]) + c / math.hypot(*line_a[:2]))


def bench_dino(bench, binary, shared, out, table):
    """The photos under names that say nothing of their order, judged by the published projection
    matrices."""
    source = os.path.join(shared, "data/oxford_dino")
    images, folder = (os.path.join(out, "dino", part) for part in ("images", "model"))
    shutil.rmtree(os.path.join(out, "dino"), ignore_errors=True)
    os.makedirs(images)
    names = sorted(os.listdir(os.path.join(source, "images")))
    numbers = list(range(len(names)))
    random.Random(1).shuffle(numbers)
    original = {}
    for number, name in zip(numbers, names):
        shutil.copy(os.path.join(source, "images", name), os.path.join(images, f"{number:03}.png"))
        original[f"{number:03}.png"] = name
    code, _, cpu, _ = bench.measured([binary, "sfm", images, "-o", folder, "-q", "--text"])
    if code not in (0, 3):
        table.row(dict(registered=0, total=len(names), cpu_s=cpu))
        return
    model = {original[name]: value for name, value in read_text_model(os.path.join(folder, "sparse/0")).items()}
    truth = {}
    with open(os.path.join(source, "projection_matrices.txt")) as file:
        for line in file:
            if not line.startswith("#"):
                part = line.split()
                values = list(map(float, part[1:]))
                truth[part[0]] = [values[0:4], values[4:8], values[8:12]]
    errors = []
    for i, a in enumerate(names):
        for b in names[i + 1:i + 5]:
            if a not in model or b not in model:
                continue
            f = fundamental(truth[a], truth[b])
            # The matrices count pixel centres from 0, a COLMAP model from 0.5.
            shift = lambda p: (p[0] - 0.5, p[1] - 0.5)
            common = model[a][2].keys() & model[b][2].keys()
            errors += [symmetric_error(f, shift(model[a][2][p]), shift(model[b][2][p])) for p in sorted(common)]
    steps = []
    for a, b in zip(names, names[1:] + names[:1]):
        if a in model and b in model:
            trace = sum(dot(x, y) for x, y in zip(model[a][0], model[b][0]))
            steps.append(math.degrees(math.acos(max(-1.0, min(1.0, (trace - 1) / 2)))))
    mean = sum(steps) / len(steps)
    deviation = math.sqrt(sum((s - mean) ** 2 for s in steps) / len(steps))
    errors.sort()
    table.row(dict(registered=len(model), total=len(names), pairs=len(errors), error_mean_px=sum(errors) / len(errors),
                   error_median_px=errors[len(errors) // 2], step_mean_deg=mean, step_sd_deg=deviation, cpu_s=cpu))


def bench_growth(bench, example, sizes, table):
    """Simulated rings: cost of each step, and the exponent with which it grows (least squares over
    log n)."""
    records = []
    for size in sizes:
        record = bench.run_json([example, str(size)])
        records.append(record | dict(cpu_s=sum(record["steps"].values())))
        table.row(records[-1])
    if len(records) < 2:
        return

    def exponent(value):
        points = [(math.log(r["images"]), math.log(max(value(r), 0.01))) for r in records]
        mx, my = (sum(p[k] for p in points) / len(points) for k in (0, 1))
        return sum((x - mx) * (y - my) for x, y in points) / sum((x - mx) ** 2 for x, _ in points)

    cells = ["exponent", "", "", f"{exponent(lambda r: r['pairs_matched']):.2f}", "", ""]
    cells += [f"{exponent(lambda r, s=s: r['steps'].get(s, 0)):.2f}" for s in STEPS]
    cells += [f"{exponent(lambda r, k=k: r[k]):.2f}" for k in ("cpu_s", "peak_mib")]
    table.row(cells)


def bench_quality(bench, binary, shared, out, plot, table):
    """`--quality` as points of CPU seconds against AUC@1 on temple_ring, with COLMAP's on the same
    plot."""
    ours = []
    for quality in ("draft", "fast", "balanced", "best"):
        source = os.path.join(shared, "data/temple_ring")
        row = bench.solve(binary, os.path.join(source, "images"), os.path.join(out, "quality", quality),
                          ["--quality", quality], os.path.join(source, "cameras_par.txt"))
        ours.append((quality, row["cpu_s"], row["auc_1"]))
        table.row(row | dict(setting=f"sat-recon --quality {quality}"))
    for name, cpu, auc in PEERS:
        table.row(dict(setting=name, cpu_s=cpu, auc_1=auc))
    draw(ours, plot)


def draw(ours, path):
    """An SVG: CPU seconds (logarithmic) to the right, AUC@1 upwards."""
    left, top, width, height = 60, 20, 560, 320
    at = lambda cpu, auc: (left + width * math.log(cpu / 1) / math.log(200), top + height * (1 - auc / 100))
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 700 400" font-family="sans-serif" font-size="12">',
             '<rect width="700" height="400" fill="white"/>']
    for auc in range(0, 101, 20):
        y = at(1, auc)[1]
        parts.append(f'<line x1="{left}" y1="{y:.1f}" x2="{left + width}" y2="{y:.1f}" stroke="#ddd"/>'
                     f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{auc}</text>')
    for cpu in (1, 2, 5, 10, 20, 50, 100, 200):
        x = at(cpu, 0)[0]
        parts.append(f'<line x1="{x:.1f}" y1="{top}" x2="{x:.1f}" y2="{top + height}" stroke="#ddd"/>'
                     f'<text x="{x:.1f}" y="{top + height + 18}" text-anchor="middle">{cpu}</text>')
    parts.append(f'<text x="{left + width / 2}" y="{top + height + 40}" text-anchor="middle">CPU seconds</text>'
                 f'<text x="18" y="{top + height / 2}" transform="rotate(-90 18 {top + height / 2})" text-anchor="middle">AUC@1, %</text>')
    line = " ".join("{:.1f},{:.1f}".format(*at(cpu, auc)) for _, cpu, auc in sorted(ours, key=lambda p: p[1]))
    parts.append(f'<polyline points="{line}" fill="none" stroke="#0a6" stroke-width="2"/>')
    for colour, points in (("#0a6", ours), ("#c40", PEERS)):
        for name, cpu, auc in points:
            x, y = at(cpu, auc)
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
                         f'<text x="{x + 8:.1f}" y="{y - 6:.1f}" fill="{colour}">{name}</text>')
    with open(path, "w") as file:
        file.write("\n".join(parts + ["</svg>", ""]))
