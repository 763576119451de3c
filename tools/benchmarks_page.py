#!/usr/bin/env python3
"""Writes docs/benchmarks.md from the JSON results of the benchmarks; or compares two sets of
results.

    benchmarks_page.py RESULTS... --out docs/benchmarks.md [--keep docs/results]
    benchmarks_page.py docs/results --out docs/benchmarks.md --check
    benchmarks_page.py --compare OLD NEW

RESULTS are folders that bench.py, compare.py and paper_tables.py left (build/*/results); of a
table that several of them hold, the last one counts. With --keep the results used are copied
there, so that the page can be made anew when only some tables were measured. --check writes
nothing and fails where the page is not what it would be. --compare prints the rows that differ,
for the message of a commit that moves results.
"""
import argparse
import json
import os
import shutil
import sys
import textwrap

from bench_results import cells, line

AUC = """AUC@T is the area under the recall curve up to T degrees over all image pairs, in percent; the error of a pair is the
larger of relative rotation and relative translation direction. Centres are in percent of the extent of the true ones."""
HELD_OUT = """Every 8th view is held out; 8-bit renders at full resolution are compared with the undistorted photos. Costs are those
of training alone."""
BENCH = "`make bench`"
# Question, text, tables, the command that measures them.
SECTIONS = [
    ("How accurate are camera poses from photos and videos?",
     AUC + " fox is judged against a COLMAP model, not a truth; can_orbit has no truth.", ["poses"], BENCH + " (`--tables poses`)"),
    ("How accurate are the angles of a turn?",
     "An object turns once before a fixed camera. Angles have their mean error removed; tilt is that of the axis in the "
     "frame of the camera. A turn alone does not determine the tilt; vertical edges of the room do here.",
     ["turns"], BENCH + " (`--tables turns`), with the captures of `make testbed`"),
    ("Does the order of the photos matter?",
     "oxford_dino, whose steps are 10°, in its order and shuffled, judged by its steps and by the published projection "
     "matrices.", ["steps", "dino"], BENCH + " (`--tables steps dino`)"),
    ("What about an orbit in a dark room?",
     "36 stills 10° apart, 640 × 480, lamp at 10 % and 100 %.", ["orbits"], BENCH + " (`--tables orbits`), with the captures of `make testbed`"),
    ("What if the photos are few, masked, dark or clipped?",
     "Harder copies of temple_ring.", ["variants"], BENCH + " (`--tables variants`)"),
    ("What is each step of the reconstruction worth?",
     "Every capture once with each step left out (`--skip`). *Worse* and *better* name captures whose AUC@1 leaves the range of "
     "the runs with all steps and other seeds by more than 0.3; of oxford_dino, which has no poses as truth, a hundred times the "
     "deviation of the steps, degrees.", ["worth"], "`make skips`"),
    ("How does it compare with COLMAP?",
     "COLMAP 3.8 and 4.2.1 with their defaults, one camera, exhaustive matching, on the same images; *on our database*: "
     "their mappers on features and matches found by sat-recon.", ["compare"], "`make compare`"),
    ("How do speed and accuracy trade off?",
     "temple_ring. COLMAP's points were measured once on a machine about twice as fast, and are not repeated.\n\n"
     "![Speed against accuracy](speed_accuracy.svg)", ["quality"], BENCH + " (`--tables quality`)"),
    ("How does the cost of poses grow with the number of images?",
     "Simulated rings with synthetic keypoints, shuffled, one observation in ten wrong. CPU seconds of each step; "
     "exponents by least squares.", ["rings"], BENCH + " (`--tables rings`)"),
    ("How good are the features?",
     "A photo and a copy moved by a known homography: share of keypoints found again within 2 px and a factor of 1.5 in "
     "scale, matches, share of them within 2 px, and their median error. Second table: matches of real views within 2 px of the "
     "true epipolar line, their share, and their median distance from it, by the angle between the views. The matcher is "
     "the same for all.", ["features", "views"], BENCH + " (`--tables features`), with the fixtures of `make oracle`"),
    ("How good are the mattes?",
     "IoU of mattes cut at a half, against the truth. Beside them the plain rule *green pixels to black* and ffmpeg's "
     "`chromakey` with the screen's true colour and the best of seven similarities.", ["key"], BENCH + " (`--tables key`)"),
    ("How good are splats, by preset?", HELD_OUT, ["splats"], BENCH + " (`--tables splats`)"),
    ("How good are splats within a given time?",
     HELD_OUT + " What does not fill its limit ended earlier, because each photo had been seen 300 times.",
     ["times"], BENCH + " (`--tables times`)"),
    ("What does the whole program cost, by preset?",
     "From the file to the splat and its evaluation, poses that came with the input ignored.\n\n"
     "![The whole program: speed against accuracy](whole.svg)", ["whole"], BENCH + " (`--tables whole`)"),
    ("What do packed splats lose?",
     "A splat of the preset `draft` is written, read again and rendered at the held-out views; PSNR over whole pictures.",
     ["packed"], BENCH + " (`--tables packed`)"),
    ("How do the numbers compare with published ones?",
     "The published captures are real and not public, ours of the same cases are simulated, and the published cost is that of a "
     "graphics card: the rows of the paper tell the order of magnitude, not which method is better. Each "
     "method had 5 minutes of two cores of processor time; frames were drawn while other programs ran, so that frames a second "
     "are too few, of NeRF and D-NeRF by far.",
     ["paper_quality", "paper_training", "paper_rendering"], "`make tables`"),
    ("Do the radiance fields compute what their papers say?",
     "Twins in torch with the same weights, rays and samples (`tests/oracle/fields.py`), and the kernels for graphics adapters "
     "on an emulated adapter against the processor; small networks. Trainings of 200 steps have the rates of a schedule's end and "
     "losses are compared in means of 50: at the first rates torch in f32 is up to 7 % from torch in f64 in single steps.",
     ["fields"], "`make oracle`"),
    ("How accurate is the shape?",
     "Case 3, draft, aligned by the true camera centres. Of the true mesh the part counts that the views see. Distances "
     "in percent of the object's size.", ["shapes"], BENCH + " (`--tables shapes`)"),
    ("Are moving parts found, and none where nothing moves?",
     "Simulated films and can_orbit: `sat-recon sfm` (with joints the whole run) and `sat-recon parts`. Errors of joints against the "
     "truth: axes, places in percent of the size, angles about their mean (root mean square), and the share of angles within two "
     "stated deviations. *Body*: rotations of the body, and before parts were looked for. The F-score is that of the meshes at rest at "
     "1 % of the size. Half B of the objects never chose anything; can_orbit and mockup-arrays-full-4 chose rules, and do not say how well these carry over.",
     ["parts"], "`make bench-parts`, with the captures of `make suite`"),
    ("How well is a satellite shown in another light?",
     "The test bed's yaw at 100 % light, every third frame, at `fast`, and its held-out views filmed again with the lamp turned about "
     "the vertical axis: PSNR in the matte of the splat as it is and of `render --light`. The variants are satellites drawn at "
     "random; variant9 chose nothing.", ["relight"], "`make bench-relight` (needs Blender)"),
    ("What does one training step cost?",
     "CPU milliseconds of the process, spherical harmonics of degree 3, 360 × 640 pixels.", ["step"], BENCH + " (`--tables step`)"),
    ("How does a training step grow?",
     "With Gaussians (640 × 480), pixels (100,000 Gaussians) and views (320 × 240).",
     ["growth_gaussians", "growth_pixels", "growth_views"], BENCH + " (`--tables growth`)"),
    ("How fast is the trainer on a graphics card?",
     "Synthetic scenes, spherical harmonics of degree 3: milliseconds of each kernel in a training step and, in brackets, the least "
     "that its bytes and operations take at the adapter's measured rates. Operations are counted as if each pair of Gaussian and "
     "tile reached all 256 pixels, so that kernels which pass over pixels can be faster. Second table: training on the same photos "
     "from the same first Gaussians; gsplat's strategy is its own.", ["gpu_kernels", "gpu_training"], "`make bench-gpu`"),
    ("How long does it take from nothing to the first picture?",
     "Bare root file systems without sat-recon, ffmpeg or numpy. Debian's packages, `pip install` of the wheel, and the sample "
     "video (72 frames) with the draft preset up to held-out views, the splat's page and the report. Where the machine had "
     "other work to do meanwhile, the seconds are more than an idle one needs.", ["first_picture"], "`make first-picture`"),
    ("What is each choice of the trainer worth?",
     "lego400, one thread. Held-out PSNR / SSIM (worst view; steps; Gaussians). The first row is the default; rows that differ "
     "by less than 0.2 dB are alike.", ["ablation"], BENCH + " (`--tables ablation`)"),
]
HEAD = """# Benchmarks

Generated by `make benchmarks-page` from the results in `docs/results`; do not edit. Each table
names the program (commit) and the machine that measured it. CPU seconds are user and system time
of all processes; memory is the peak of resident memory.
"""


def load(folders):
    """Tables by name; later folders win, but not with a part of a table."""
    found = {}
    for folder in folders:
        for name in sorted(os.listdir(folder)):
            if name.endswith(".json"):
                with open(os.path.join(folder, name)) as file:
                    record = json.load(file)
                if "table" not in record:  # of another page
                    continue
                rows = len(found.get(record["table"], {"rows": []})["rows"])
                if len(record["rows"]) < rows:
                    print(f"{folder}/{name} has {len(record['rows'])} rows of {rows}: the earlier table stays", file=sys.stderr)
                    continue
                found[record["table"]] = record | {"path": os.path.join(folder, name)}
    return found


def wrapped(text):
    """Paragraphs of at most 100 columns."""
    return "\n\n".join(textwrap.fill(" ".join(part.split()), 100, break_on_hyphens=False) for part in text.split("\n\n"))


def table(record):
    rows = [line(record["columns"]), f"|{'---|' * len(record['columns'])}"]
    rows += [line(cells(record["table"], row)) for row in record["rows"]]
    return "\n".join(rows) + (f"\n\n{record['note']}" if "note" in record else "")


def page(found):
    parts, missing = [HEAD], []
    for question, text, names, command in SECTIONS:
        present = [found[name] for name in names if name in found]
        if not present:
            missing.append(question)
            continue
        parts.append(f"## {question}\n{wrapped(text)}\n\nMeasured by {command}.")
        for record in present:
            parts.append(f"{table(record)}\n\n*Program {record['version']}; {record['machine']}.*")
    if missing:
        parts.append("## Not measured\n" + "\n".join(f"- {question}" for question in missing))
    return "\n\n".join(part.strip() for part in parts) + "\n"


def compare(old, new):
    """Prints the rows that differ between two sets of results."""
    for name in sorted(old.keys() & new.keys()):
        before, after = ({tuple(cells(name, row)[:2]): cells(name, row) for row in r["rows"]} for r in (old[name], new[name]))
        for key in before.keys() & after.keys():
            if before[key] != after[key]:
                print(f"{name}\n  - {line(before[key])}\n  + {line(after[key])}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="*")
    parser.add_argument("--out")
    parser.add_argument("--keep")
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--compare", nargs=2, metavar=("OLD", "NEW"))
    args = parser.parse_args()
    if args.compare:
        return compare(*(load([folder]) for folder in args.compare))
    if not args.results or not args.out:
        parser.error("folders of results and --out are needed")
    found = load(args.results)
    if args.keep:
        os.makedirs(args.keep, exist_ok=True)
        for record in found.values():
            target = os.path.join(args.keep, record["table"] + ".json")
            if os.path.abspath(record["path"]) != os.path.abspath(target):
                shutil.copyfile(record["path"], target)
    if args.check:
        with open(args.out) as file:
            same = file.read() == page(found)
        sys.exit(None if same else f"{args.out} is not what the results say: run 'make benchmarks-page'")
    with open(args.out, "w") as file:
        file.write(page(found))


if __name__ == "__main__":
    main()
