#!/usr/bin/env python3
"""Gives every flag with a value numbers that make no sense: exit code 1, never a crash.

    flags.py PROGRAM [--results FILE]

The input is missing, so that whatever a flag takes ends with exit code 1; `nan` and `inf` must be
refused by the flag itself, except by flags whose value is a name, which are listed.
"""
import argparse
import json
import os
import re
import shutil
import sys
import tempfile

import harness

COMMANDS = ["run", "render", "export", "compare", "bench", "batch", "view", "collect"]
VALUES = ["nan", "inf", "-inf", "-1", "1e308", "18446744073709551615", "18446744073709551616", ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--results")
    args = parser.parse_args()
    program, tried, crashes, names = os.path.abspath(args.program), 0, [], set()
    folder = tempfile.mkdtemp()  # some flags are names of folders that are made
    for command in COMMANDS:
        said = harness.run(program, [command, "--help-all"])["said"]
        for flag in sorted(set(re.findall(r"(--[a-z0-9-]+) <[^>]*>", said))):
            for value in VALUES:
                told = harness.run(program, [command, "/no/such", f"{flag}={value}"], cwd=folder)
                tried += 1
                if told["code"] != 1 or harness.crashed(told):
                    crashes.append(f"{command} {flag}={value}: {told['code']}")
                if value in ("nan", "inf") and "invalid value" not in told["said"] and "unexpected" not in told["said"] and "required" not in told["said"]:
                    names.add(flag)
    shutil.rmtree(folder)
    result = {"tried": tried, "crashes": crashes, "take_names": sorted(names)}
    print(json.dumps(result, indent=1))
    if args.results:
        with open(args.results, "w") as file:
            file.write(json.dumps(result, indent=1) + "\n")
    sys.exit(1 if crashes else 0)


if __name__ == "__main__":
    main()
