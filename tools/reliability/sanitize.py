#!/usr/bin/env python3
"""Runs sanitizers, Valgrind, Miri and checks of dependencies, and keeps what they said last.

    sanitize.py --out FOLDER [--seconds 60] [--only WORD...] [--results FILE]

The sanitizers need nightly Rust, Miri its rust-src, too. Whole logs lie in FOLDER, the last lines
that say what came of it in the results; a check whose tool is not installed, or whose database of
advisories cannot be reached, is said to be left out.
Exits with 1 where one was not clean.
"""
import argparse
import json
import os
import re
import subprocess
import sys

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
CPP = "-fsanitize=address,undefined -fsanitize-undefined-trap-on-error"
MIRI = {"MIRIFLAGS": "-Zmiri-disable-isolation"}
# rayon's queues (crossbeam-epoch) break the rules of Stacked Borrows and keep those of Tree Borrows;
# its threads live as long as the program.
RAYON = {"MIRIFLAGS": "-Zmiri-disable-isolation -Zmiri-tree-borrows -Zmiri-ignore-leaks"}
# The flag by which a run is cancelled lives as long as the program; its test leaks one a round.
CANCEL = {"MIRIFLAGS": "-Zmiri-disable-isolation -Zmiri-ignore-leaks -Zmiri-many-seeds=0..16"}
VALGRIND = {"CARGO_TARGET_{HOST}_RUNNER": "valgrind -q --error-exitcode=99", "RAYON_NUM_THREADS": "2"}
# Name: tool that it needs, as it is asked for its version; environment; arguments of cargo.
CHECKS = {
    "address sanitizer, every reader with mutated files":
        ("rustc +nightly --version", {"RUSTFLAGS": "-Zsanitizer=address"},
         "run --profile sanitize --locked --target {host} -p fuzz --no-default-features -- {seconds}"),
    "address and undefined-behaviour sanitizer, Ceres and its C++ border":
        ("rustc +nightly --version", {"RUSTFLAGS": "-Zsanitizer=address", "CXXFLAGS": CPP},
         "test --profile sanitize --locked --target {host} -p sfm --lib -- ceres bundle"),
    "Valgrind, readers":
        ("valgrind --version", VALGRIND, "test --locked -p scene --lib -- io::"),
    "Valgrind, kernels":
        ("valgrind --version", VALGRIND, "test --locked -p splat --lib -- cpu:: parity::kernels"),
    "Valgrind, Ceres and its C++ border":
        ("valgrind --version", VALGRIND, "test --locked -p sfm --lib -- ceres bundle"),
    "Miri, parsers":
        ("cargo +nightly miri --version", MIRI, "miri test -p scene --lib -- io::attitude io::exif io::mesh::tests io::name io::ply io::poses io::tiff_directory"),
    "Miri, scalar kernels":
        ("cargo +nightly miri --version", RAYON,
         "miri test -p splat --no-default-features --lib -- cpu::bounds cpu::sh::tests::the_gradient cpu::shared cpu::sort cpu::target"),
    "Miri, progress and cancel, other orders of its threads":
        ("cargo +nightly miri --version", CANCEL,
         "miri test -p scene --lib -- progress"),
    "thread sanitizer, progress and cancel":
        ("rustc +nightly --version", {"RUSTFLAGS": "-Zsanitizer=thread"},
         "test --profile sanitize -Zbuild-std --target {host} -p scene --lib -- progress"),
    "licences, sources and wildcards of dependencies":
        ("cargo deny --version", {}, "deny --offline check licenses bans sources"),
    "advisories":
        ("cargo deny --version", {}, "deny check advisories"),
}
# Lines that say what came of it.
TELLING = re.compile(r"^test result|^\| |ERROR: AddressSanitizer|WARNING: ThreadSanitizer|^==\d+== [A-Z]|Undefined Behavior|runtime error"
                     r"|advisories|licenses ok|licenses FAILED|^error")
NO_DATABASE = re.compile(r"failed to (fetch|load|open) advisory database")


def host():
    said = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    return re.search(r"^host: (.*)$", said, re.M).group(1)


def is_installed(tool):
    try:
        return subprocess.run(tool.split(), cwd=ROOT, capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


def check(name, seconds, folder):
    tool, environment, arguments = CHECKS[name]
    triple = host()
    environment = {key.format(HOST=triple.upper().replace("-", "_")): value for key, value in environment.items()}
    nightly = [] if arguments.startswith("deny") or "valgrind" in tool else ["+nightly"]
    command = ["cargo", *nightly, *arguments.format(host=triple, seconds=seconds).split()]
    shown = " ".join([*(f"{k}='{v}'" for k, v in environment.items()), *command])
    print(name, flush=True)
    if not is_installed(tool):
        return {"what": name, "command": shown, "said": f"left out: `{tool}` fails, it is not installed", "clean": None}
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True)
    text = done.stdout + done.stderr
    with open(os.path.join(folder, re.sub(r"\W+", "_", name) + ".log"), "w") as file:
        file.write(text)
    if NO_DATABASE.search(text):
        return {"what": name, "command": shown, "said": "left out: the database of advisories cannot be reached", "clean": None}
    telling = [line for line in text.splitlines() if TELLING.search(line)]
    if telling and telling[0].startswith("| target"):
        rows = [[int(cell) for cell in line.split("|")[2:5]] for line in telling if re.match(r"\| [a-z-]+ \| \d", line)]
        executions, _, failures = (sum(column) for column in zip(*rows))
        telling = [f"{executions} executions of {len(rows)} targets, {failures} failures"]
    said = "; ".join(telling[-3:]) or f"exit code {done.returncode}"
    # A filter that fits no test finds nothing.
    is_clean = done.returncode == 0 and ("test" not in command or re.search(r"^test result: ok\. [1-9]", text, re.M) is not None)
    return {"what": name, "command": shown, "said": said, "clean": is_clean}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", required=True)
    parser.add_argument("--seconds", default="60")
    parser.add_argument("--only", nargs="+", default=[""])
    parser.add_argument("--results")
    args = parser.parse_args()
    os.makedirs(args.out, exist_ok=True)
    rows = {}
    if args.results and os.path.exists(args.results):
        with open(args.results) as file:
            rows = {row["what"]: row for row in json.load(file)["rows"]}
    ran = [name for name in CHECKS if any(word in name for word in args.only)]
    for name in ran:
        rows[name] = check(name, args.seconds, args.out)
        print({True: "clean", False: "NOT CLEAN", None: "LEFT OUT"}[rows[name]["clean"]], rows[name]["said"], flush=True)
        if args.results:
            with open(args.results, "w") as file:
                json.dump({"rows": [rows[n] for n in CHECKS if n in rows]}, file, indent=1)
                file.write("\n")
    sys.exit(1 if any(rows[name]["clean"] is False for name in ran) else 0)


if __name__ == "__main__":
    main()
