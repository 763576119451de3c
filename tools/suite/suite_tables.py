"""Tables of the suite's results: by class and half, stated against true, the made-wrong set."""

import statistics

import captures

# What a class is judged by: field and its name.
METRICS = {
    "yaw": ("angle_rms_deg", "angles, ° RMS"), "hand": ("angle_rms_deg", "angles, ° RMS"),
    "tumble": ("rotation_median_deg", "attitude, ° median"), "orbit": ("rotation_median_deg", "rotation, ° median"),
    "walk": ("rotation_median_deg", "rotation, ° median"), "few": ("auc_3", "AUC@3"),
}
WORST = {"yaw": "angle_max_deg", "hand": "angle_max_deg"}


def number(value, digits=3):
    return "–" if value is None else f"{value:.{digits}f}"


def line(row):
    """One row in one line, for the terminal."""
    motion = row["capture"].split("-")[1] if row["group"] == "suite" else ""
    main = row.get(METRICS.get(motion, ("rotation_median_deg",))[0])
    worst = row.get(WORST.get(motion, "rotation_max_deg"))
    return (f"{row['capture']:28} {row['tool']:12} {row.get('registered', 0)}/{row['total']} {row['model']:10} exit {row['exit']} "
            f"{number(main)}° max {number(worst)}° {row.get('motion_named') or ''} {row['cpu_s']:.0f} CPU s")


def share_above(values, part):
    """The value that `part` of the values do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else None


def grid(head, body):
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(str(c) for c in row) + " |" for row in body])


def of_class(rows):
    """{(motion, light, frames a second, tool): rows}, in order."""
    classes = {}
    for row in rows:
        capture = captures.parse(row["capture"])
        classes.setdefault((capture.motion, capture.light, capture.fps, row["tool"]), []).append(row)
    order = lambda key: (captures.MOTIONS.index(key[0]), captures.LIGHTS.index(key[1]), key[2], key[3])  # noqa: E731
    return {key: classes[key] for key in sorted(classes, key=order)}


def class_cells(rows, motion):
    """Captures, right models, frames, median, 90 %, worst of the errors, CPU seconds."""
    values = [r[METRICS[motion][0]] for r in rows if r.get(METRICS[motion][0]) is not None]
    worst = [r[WORST.get(motion, "rotation_max_deg")] for r in rows if r.get(WORST.get(motion, "rotation_max_deg")) is not None]
    right = sum(r["model"] == "right" for r in rows)
    frames = f"{sum(r.get('registered', 0) for r in rows)}/{sum(r['total'] for r in rows)}"
    median = statistics.median(values) if values else None
    return [f"{right}/{len(rows)}", frames, number(median), number(share_above(values, 0.9)), number(max(worst, default=None)),
            number(statistics.median(r["cpu_s"] for r in rows), 0)]


def class_table(rows):
    body = []
    for (motion, light, fps, tool), members in of_class(rows).items():
        for half in ("A", "B"):
            part = [r for r in members if r["half"] == half]
            if part:
                body.append([motion, light, fps or "photos", tool, half, METRICS[motion][1], *class_cells(part, motion)])
    head = ["motion", "light", "frames/s", "tool", "half", "error", "right", "frames", "median", "90 %", "worst image", "CPU s"]
    return grid(head, body)


def verdict_table(rows):
    """How often a right or wrong model was said to be well, doubtful, or refused."""
    body = []
    for group, half in (("suite", "A"), ("suite", "B"), ("wrong", "-")):
        part = [r for r in rows if r["group"] == group and r["half"] == half and r["tool"] == "sat-recon"]
        for model in ("right", "wrong", "impossible", "none"):
            kind = [r for r in part if r["model"] == model]
            if kind:
                body.append([group, half, model, len(kind)] + [sum(r["stated"] == s for r in kind) for s in ("well", "doubtful", "refused")])
    return grid(["set", "half", "model", "captures", "said: well (0)", "doubtful (3)", "refused"], body)


def deviation_table(rows):
    """Share of errors within one and two stated deviations, and the ratio's root mean square."""
    body = []
    for half in ("A", "B"):
        for motion in captures.MOTIONS:
            ratios = [x for r in rows if r["half"] == half and r["tool"] == "sat-recon" and r["model"] == "right"
                      and r["capture"].split("-")[1] == motion for x in r.get("deviation_ratios", [])]
            if ratios:
                within = [f"{100 * sum(x <= k for x in ratios) / len(ratios):.0f} %" for k in (1, 2)]
                body.append([motion, half, len(ratios), *within, number(share_above(ratios, 0.5), 2)])
    return grid(["motion", "half", "components", "within 1 σ (68 %)", "within 2 σ (95 %)", "median error / σ (0.67)"], body)


def motion_table(rows):
    """What motions were taken for."""
    counts = {}
    for r in rows:
        if r["group"] == "suite" and r["tool"] == "sat-recon":
            named = f"{r.get('motion_named') or 'nothing'}{', steady' if r.get('steady_named') else ''}"
            key = (r.get("true_motion", "?"), r["half"], named)
            counts[key] = counts.get(key, 0) + 1
    return grid(["true motion", "half", "named", "captures"], [[*k, n] for k, n in sorted(counts.items())])


def frames_table(rows):
    """Poses of every frame of the videos, and what the motion report says, by capture."""
    body = []
    for r in rows:
        if r["tool"] == "sat-recon" and r.get("frames"):
            body.append([r["capture"], r["half"], f"{r['frames']}/{r['frames_total']}", number(r["frames_median_deg"]), number(r["frames_max_deg"]),
                         number(r.get("frames_error_over_deviation"), 2), number(r.get("rate_error_percent"), 2), number(r.get("axis_error_deg"), 2),
                         number(r.get("axis_deviation_deg"), 2), number(r.get("inertia_error_percent"), 1)])
    head = ["capture", "half", "frames", "attitude, ° median", "worst", "median error / σ", "rate, %", "axis, °", "stated, °", "inertia ratios, %"]
    return grid(head, body)


def wrong_table(rows):
    body = []
    for r in rows:
        if r["group"] != "wrong" or r["tool"] != "sat-recon":
            continue
        fails = r["stated"] == "well" and r["model"] in ("wrong", "impossible")
        yellow = [light["what"] for light in r.get("lights", []) if light["level"] not in ("good", "unknown")]
        body.append([r["capture"].split("/")[1], r["asked"], f"{r.get('registered', 0)}/{r['total']}", r["model"], r.get("truth", "–"),
                     number(r.get("pairs_median_deg"), 1), r["stated"], "**fails**" if fails else "", ", ".join(yellow), number(r["cpu_s"], 0)])
    return grid(["case", "asked", "frames", "model", "truth", "pairs, °", "said", "", "lights not green", "CPU s"], body)


def tables(rows):
    """All tables as Markdown."""
    suite = [r for r in rows if r["group"] == "suite"]
    parts = []
    if suite:
        parts += ["## By class", class_table(suite), "## Motions", motion_table(suite), "## Every frame", frames_table(suite),
                  "## Stated deviations", deviation_table(suite)]
    parts += ["## Said and true", verdict_table(rows)]
    if any(r["group"] == "wrong" for r in rows):
        parts += ["## Made wrong", wrong_table(rows)]
    return "\n\n".join(parts)
