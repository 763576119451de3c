"""What the benchmarks measure, as JSON: one file a table, read by benchmarks_page.py.

A file holds {"table", "version", "machine", "columns", "rows"}. A row is an object of numbers and
names, whose columns are declared in TABLES below; or, for tables that another program printed, a
list of cells.
"""
import json
import os
import platform
import subprocess

HERE = os.path.dirname(os.path.abspath(__file__))

POSES = [
    ("input", "{input}"), ("tool", "{tool}"), ("registered", "{registered} of {total}"),
    ("AUC@1 / 3 / 5 / 10", "{auc_1:.1f} / {auc_3:.1f} / {auc_5:.1f} / {auc_10:.1f}"),
    ("rotation median", "{rotation_median_deg:.3f}°"),
    ("centre median / max, %", "{centre_median_pct:.3f} / {centre_max_pct:.3f}"),
    ("CPU s", "{cpu_s:.1f}"), ("wall s", "{wall_s:.1f}"), ("peak MiB", "{peak_mib:.0f}"),
]
STEPS = ["matching", "verification", "guided-matching", "mapping", "camera-model", "final-adjustment", "motion"]
SPLATS = [
    ("input", "{input}"), ("setting", "{setting}"), ("PSNR / SSIM", "{psnr:.2f} / {ssim:.4f}"),
    ("PSNR, 60° held out", "{psnr_sector:.2f}"),
    ("worst view", "{psnr_worst:.2f}"), ("Gaussians", "{gaussians:,}"), ("wall s", "{wall_s:.1f}"),
    ("CPU s", "{cpu_s:.1f}"), ("peak MiB", "{peak_mib:.0f}"), ("`.sog`, kB", "{sog_kb:.0f}"), ("`.spz`, kB", "{spz_kb:.0f}"),
]
# Columns of each table: heading, and the format of a row's fields. A field that is missing prints
# as –.
TABLES = {
    "poses": POSES, "variants": POSES, "orbits": POSES, "compare": POSES,
    "turns": [
        ("input", "{input}"), ("tool", "{tool}"), ("registered", "{registered} of {total}"),
        ("angles RMS / max", "{angle_rms_deg:.4f}° / {angle_max_deg:.4f}°"), ("tilt of the axis", "{axis_tilt_deg:.3f}°"),
        ("centre median / max, % of the radius", "{centre_median_pct:.3f} / {centre_max_pct:.3f}"),
        ("closing error", "{closing_deg:+.4f}°"), ("CPU s", "{cpu_s:.1f}"),
    ],
    "steps": [
        ("input", "{input}"), ("registered", "{registered} of {total}"), ("motion", "{motion}"),
        ("steps", "{step_mean_deg:.4f}°"), ("standard deviation", "{step_sd_deg:.4f}°"), ("CPU s", "{cpu_s:.1f}"),
    ],
    "skips": [
        ("input", "{input}"), ("left out", "{skipped}"), ("registered", "{registered} of {total}"), ("AUC@1", "{auc_1:.1f}"),
        ("steps, sd", "{step_sd_deg:.4f}°"), ("change", "{change:+.2f}"), ("all steps, by seed", "{low:.1f} to {high:.1f}"), ("CPU s", "{cpu_s:.1f}"),
    ],
    "worth": [
        ("step", "`{step}`"), ("captures", "{tried}"), ("model changed", "{moved}"), ("worse without it, AUC@1", "{worse}"),
        ("better without it", "{better}"),
    ],
    "dino": [
        ("registered", "{registered} of {total}"), ("pairs of observations", "{pairs}"),
        ("symmetric epipolar error, mean / median, px", "{error_mean_px:.3f} / {error_median_px:.3f}"),
        ("steps, mean ± sd", "{step_mean_deg:.3f}° ± {step_sd_deg:.3f}°"), ("CPU s", "{cpu_s:.1f}"),
    ],
    "quality": [("setting", "{setting}"), ("CPU s", "{cpu_s:.1f}"), ("AUC@1", "{auc_1:.1f}")],
    "rings": [
        ("images", "{images}"), ("registered", "{registered}"), ("keypoints", "{keypoints:,}"),
        ("pairs matched / verified", "{pairs_matched:,} / {pairs_verified:,}"),
        ("rotation median", "{rotation_median_deg:.4f}°"), ("centre max, %", "{centre_max_pct:.4f}"),
        *((step, f"{{steps[{step}]:.1f}}") for step in STEPS), ("all, CPU s", "{cpu_s:.1f}"), ("peak MiB", "{peak_mib:.0f}"),
    ],
    "splats": SPLATS, "times": SPLATS,
    "whole": [
        ("input", "{input}"), ("preset", "{setting}"), ("PSNR", "{psnr:.2f}"), ("rotation median", "{rotation_median_deg:.3f}°"),
        ("Gaussians", "{gaussians:,}"), ("wall s", "{wall_s:.0f}"), ("CPU s", "{cpu_s:.0f}"), ("peak MiB", "{peak_mib:.0f}"),
    ],
    "packed": [
        ("input", "{input}"), ("format", "`.{format}`"), ("Gaussians", "{gaussians:,}"), ("kB", "{kb:.0f}"),
        ("bytes a Gaussian", "{each:.1f}"), ("PSNR", "{psnr:.2f}"), ("lost, dB", "{lost:.2f}"),
    ],
    "first_picture": [
        ("system", "{system}"), ("packages", "{packages}"), ("install them, s", "{packages_s:.0f}"),
        ("install the wheel, s", "{wheel_s:.0f}"), ("run, s", "{run_s:.0f}"), ("together, s", "{total_s:.0f}"),
        ("CPU s", "{cpu_s:.0f}"), ("CPU s of other work meanwhile", "{other_cpu_s:.0f}"),
    ],
    "shapes": [
        ("surface", "{surface}"), ("points", "{points:,}"), ("accuracy mean / median, %", "{accuracy_mean_pct:.3f} / {accuracy_median_pct:.3f}"),
        ("completeness mean / median, %", "{completeness_mean_pct:.3f} / {completeness_median_pct:.3f}"),
        ("precision, recall at 1 %", "{precision_pct:.1f}, {recall_pct:.1f}"),
        ("F-score at 1 %, at 0.5 %", "{f_score_pct:.1f}, {f_score_half_pct:.1f} %"), ("rods and edges of sheets found, %", "{thin_recall_pct:.1f}"),
        ("Chamfer, %", "{chamfer_pct:.3f}"),
    ],
    "parts": [
        ("capture", "{capture}"), ("half", "{half}"), ("joints, missed, invented", "{joints}, {missed}, {invented}"),
        ("axes, °", "{axis_deg}"), ("places, %", "{place_pct}"), ("angles, °", "{angles_deg}"), ("within 2 σ", "{within_2_sigma}"),
        ("body, ° (before)", "{rotation_deg:.3f} ({rotation_before_deg:.3f})"),
        ("PSNR, in the matte", "{psnr_of_parts:.2f}, {psnr_mask_of_parts:.2f}"),
        ("of one rigid splat", "{psnr_rigid:.2f}, {psnr_mask_rigid:.2f}"), ("F-score", "{f_score_pct:.1f} %"), ("CPU s", "{cpu_s:.0f}"), ("peak MiB", "{peak_mib:.0f}"),
    ],
}


def machine():
    """The processor's name and the number of cores."""
    name = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo") as file:
            name = next((line.split(":", 1)[1].strip() for line in file if line.startswith("model name")), name)
    return f"{name}, {os.cpu_count()} cores"


def version():
    """The commit of the tree that the benchmarks belong to."""
    git = ["git", "-C", HERE, "describe", "--always", "--dirty=+", "--abbrev=9"]
    said = subprocess.run(git, capture_output=True, text=True)
    return said.stdout.strip() or "unknown"


def cell(form, row):
    try:
        return form.format(**row)
    except (KeyError, TypeError, ValueError, IndexError):
        return "–"


def cells(name, row):
    """The printed cells of a row."""
    return row if isinstance(row, list) else [cell(form, row) for _, form in TABLES[name]]


def line(texts):
    return "| " + " | ".join(texts) + " |"


class Results:
    """A folder of tables."""

    def __init__(self, folder):
        self.folder = folder
        os.makedirs(folder, exist_ok=True)

    def table(self, name):
        """A table of TABLES."""
        return Table(self.folder, name)

    def printed(self, names, text):
        """Tables in the Markdown that another program printed, in the order of `names`; what is
        not a table passes by."""
        tables, header = [], None
        for row in map(str.strip, text.splitlines()):
            parts = [part.strip() for part in row.strip("|").split("|")]
            if row.startswith("|--"):
                tables.append(Table(self.folder, names[len(tables)], header))
            elif row.startswith("|") and tables and len(parts) == len(tables[-1].columns):
                tables[-1].row(parts)
            header = parts if row.startswith("|") else None
            if row.startswith("time ∝") and tables:
                tables[-1].note(row)
        return tables


class Table:
    """Prints rows as they are measured, and keeps the file up to date with them."""

    def __init__(self, folder, name, columns=None):
        os.makedirs(folder, exist_ok=True)
        self.name, self.path = name, os.path.join(folder, name + ".json")
        self.columns = columns or [heading for heading, _ in TABLES[name]]
        self.record = {
            "table": name, "version": version(), "machine": machine(), "columns": self.columns, "rows": [],
        }
        if columns is None:
            self.keep_earlier_rows()
        print(f"\n{line(self.columns)}\n|{'---|' * len(self.columns)}", flush=True)

    def keep_earlier_rows(self):
        """Rows of the same program on the same machine stay until they are measured again."""
        if os.path.exists(self.path):
            with open(self.path) as file:
                earlier = json.load(file)
            if all(earlier[key] == self.record[key] for key in ("version", "machine", "columns")):
                self.record["rows"] = earlier["rows"]

    def row(self, row):
        if isinstance(row, dict):  # where it lies on this machine says nothing elsewhere
            row = {key: value for key, value in row.items() if key not in ("name", "model")}
        rows = self.record["rows"]
        same = lambda other: isinstance(row, dict) and cells(self.name, other)[:2] == cells(self.name, row)[:2]
        at = next((i for i, other in enumerate(rows) if same(other)), len(rows))
        rows[at:at + 1] = [row]
        self.save()
        print(line(cells(self.name, row)), flush=True)

    def note(self, text):
        self.record["note"] = text
        self.save()
        print(text, flush=True)

    def save(self):
        with open(self.path, "w") as file:
            json.dump(self.record, file, indent=1, ensure_ascii=False)
            file.write("\n")
