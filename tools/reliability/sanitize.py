#!/usr/bin/env python3
"""Runs sanitizers, Miri and checks of advisories, and keeps what they said last.

    sanitize.py --out FOLDER [--seconds 60] [--only WORD...] [--results FILE]

Needs nightly Rust with rust-src and Miri. Whole logs lie in FOLDER, the last lines that say what
came of it in the results. What is not installed is said so, and counts as a failure. Exits with 1
where one was not clean.
"""
import argparse
import json
import os
import re
import subprocess
import sys

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
CPP = "-fsanitize=address,undefined -fsanitize-undefined-trap-on-error"
# Name: environment, arguments of cargo.
CHECKS = {
    "address sanitizer, every reader with mutated files":
        ({"RUSTFLAGS": "-Zsanitizer=address"}, "run --target {host} -p fuzz --no-default-features -- {seconds}"),
    "address and undefined-behaviour sanitizer, Ceres and its C++ border":
        ({"RUSTFLAGS": "-Zsanitizer=address", "CXXFLAGS": CPP}, "test --target {host} -p sfm --lib -- ceres bundle"),
    "Miri, parsers":
        ({"MIRIFLAGS": "-Zmiri-disable-isolation"}, "miri test -p scene --lib -- io::bytes io::name io::splats::plain flag"),
    "Miri, scalar kernels":
        ({"MIRIFLAGS": "-Zmiri-disable-isolation"}, "miri test -p splat --no-default-features --lib -- cpu::backend cpu::bounds cpu::sh cpu::shared cpu::sort cpu::target cpu::workspace"),
    "advisories": ({}, "deny --offline check advisories"),
}
# Lines that say what came of it.
TELLING = re.compile(r"^test result|^\| |ERROR: AddressSanitizer|Undefined Behavior|runtime error|advisories|^error")


def host():
    said = subprocess.run(["rustc", "-vV"], capture_output=True, text=True, check=True).stdout
    return re.search(r"^host: (.*)$", said, re.M).group(1)


def check(name, environment, arguments, folder):
    command = ["cargo", *([] if arguments.startswith("deny") else ["+nightly"]), *arguments.split()]
    print(name, flush=True)
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True)
    text = done.stdout + done.stderr
    with open(os.path.join(folder, re.sub(r"\W+", "_", name) + ".log"), "w") as file:
        file.write(text)
    telling = [line for line in text.splitlines() if TELLING.search(line)]
    if telling and telling[0].startswith("| target"):
        rows = [[int(cell) for cell in line.split("|")[2:5]] for line in telling if re.match(r"\| [a-z-]+ \| \d", line)]
        executions, _, failures = (sum(column) for column in zip(*rows))
        telling = [f"{executions} executions of {len(rows)} targets, {failures} failures"]
    said = "; ".join(telling[-3:]) or f"exit code {done.returncode}"
    shown = " ".join([*(f"{k}='{v}'" for k, v in environment.items()), *command])
    return {"what": name, "command": shown, "said": said, "clean": done.returncode == 0}


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
        environment, arguments = CHECKS[name]
        rows[name] = check(name, environment, arguments.format(host=host(), seconds=args.seconds), args.out)
        print("clean" if rows[name]["clean"] else "NOT CLEAN", rows[name]["said"], flush=True)
        if args.results:
            with open(args.results, "w") as file:
                json.dump({"rows": [rows[n] for n in CHECKS if n in rows]}, file, indent=1)
                file.write("\n")
    sys.exit(0 if all(rows[name]["clean"] for name in ran) else 1)


if __name__ == "__main__":
    main()
