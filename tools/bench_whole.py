"""The whole program, from video or photos to a splat: CPU seconds against the PSNR of held-out
views and against the error of the poses, at each preset. Called by bench.py; draws
docs/whole.svg."""
import json
import math
import os
import shutil

CAPTURES = [
    # name, input, truth; below SHARED/data or, with a slash in front, below the test bed
    ("temple_ring", "temple_ring/images", "temple_ring/cameras_par.txt"),
    ("fox", "fox/images", "fox/transforms.json"),
    ("yaw, 10 % light (case 3)", "/case3/video.mp4", "/case3/sparse"),
]
COLOURS = ["#0a6", "#26c", "#a4a"]


def bench_whole(bench, binary, shared, out, qualities, plot, table):
    """Rows of the table, and the figure from them and from COLMAP's rows of the table `compare`."""
    rows = []
    for name, source, truth in CAPTURES:
        source, truth = (bench.TESTBED + p if p.startswith("/") else os.path.join(shared, "data", p) for p in (source, truth))
        for quality in qualities:
            folder = os.path.join(out, "whole", f"{name} {quality}")
            shutil.rmtree(folder, ignore_errors=True)
            command = [binary, "eval", source, "-o", folder, "-q", "--ignore-poses", "--quality", quality]
            _, wall, cpu, peak = bench.measured(command)
            with open(os.path.join(folder, "run.json")) as file:
                run = json.load(file)
            errors = bench.pose_errors(binary, folder, truth)
            row = dict(input=name, setting=quality, cpu_s=cpu, wall_s=wall, peak_mib=peak, psnr=run["evaluation"]["mean"]["psnr"],
                       rotation_median_deg=errors["rotation_median_deg"], gaussians=run["splat"]["gaussians"])
            rows.append(row)
            table.row(row)
    draw(rows, peers(os.path.join(os.path.dirname(plot), "results/compare.json")), plot)


def peers(path):
    """COLMAP's points of the table `compare`: (input, CPU s, rotation error in degrees)."""
    if not os.path.exists(path):
        return []
    with open(path) as file:
        table = json.load(file)
    at = {name: i for i, name in enumerate(table["columns"])}
    cells = [(r[at["input"]], r[at["tool"]], r[at["CPU s"]], r[at["rotation median"]]) for r in table["rows"]]
    return [(name, float(cpu), float(error.rstrip("°"))) for name, tool, cpu, error in cells
            if tool == "COLMAP 4.2.1 incremental" and error != "–"]


class Panel:
    """Axes of a figure: CPU seconds to the right (logarithmic), a figure upwards."""

    def __init__(self, left, title, low, high, logarithmic):
        self.left, self.title, self.low, self.high, self.logarithmic = left, title, low, high, logarithmic

    def at(self, cpu, value):
        share = (math.log(value / self.low) / math.log(self.high / self.low) if self.logarithmic
                 else (value - self.low) / (self.high - self.low))
        return self.left + 330 * math.log(cpu / 5) / math.log(200), 30 + 300 * (1 - share)

    def axes(self, ticks):
        yield f'<text x="{self.left}" y="18" font-weight="bold">{self.title}</text>'
        for value in ticks:
            y = self.at(5, value)[1]
            yield (f'<line x1="{self.left}" y1="{y:.1f}" x2="{self.left + 330}" y2="{y:.1f}" stroke="#ddd"/>'
                   f'<text x="{self.left - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
        for cpu in (5, 10, 20, 50, 100, 200, 500, 1000):
            x = self.at(cpu, self.high)[0]
            yield (f'<line x1="{x:.1f}" y1="30" x2="{x:.1f}" y2="330" stroke="#ddd"/>'
                   f'<text x="{x:.1f}" y="347" text-anchor="middle">{cpu}</text>')
        yield f'<text x="{self.left + 165}" y="368" text-anchor="middle">CPU seconds, from file to splat</text>'

    def line(self, points, colour):
        """A preset a point: (name, CPU s, value)."""
        places = [self.at(cpu, value) for _, cpu, value in points]
        yield f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in places)}" fill="none" stroke="{colour}" stroke-width="2"/>'
        for (name, _, _), (x, y) in zip(points, places):
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/><text x="{x + 6:.1f}" y="{y - 6:.1f}" fill="{colour}">{name}</text>'


def draw(rows, others, path):
    """An SVG of two panels."""
    pictures, poses = Panel(50, "PSNR of held-out views, dB", 26, 42, False), Panel(490, "median rotation error, degrees", 0.01, 2, True)
    parts = ['<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 890 420" font-family="sans-serif" font-size="11">',
             '<rect width="890" height="420" fill="white"/>', *pictures.axes(range(26, 43, 4)), *poses.axes((0.01, 0.03, 0.1, 0.3, 1))]
    for (name, _, _), colour, x in zip(CAPTURES, COLOURS, (50, 200, 290)):
        own = [row for row in rows if row["input"] == name]
        parts += pictures.line([(r["setting"], r["cpu_s"], r["psnr"]) for r in own], colour)
        parts += poses.line([(r["setting"], r["cpu_s"], r["rotation_median_deg"]) for r in own], colour)
        parts.append(f'<text x="{x}" y="395" fill="{colour}">● {name}</text>')
        for other, cpu, error in others:
            if other.split("_")[0] == name.split("_")[0] and error < poses.high:
                px, py = poses.at(cpu, error)
                parts.append(f'<rect x="{px - 4:.1f}" y="{py - 4:.1f}" width="8" height="8" fill="{colour}"/>'
                             f'<text x="{px + 6:.1f}" y="{py - 6:.1f}" fill="{colour}">COLMAP 4.2.1, poses alone</text>')
    with open(path, "w") as file:
        file.write("\n".join(parts + ["</svg>", ""]))
