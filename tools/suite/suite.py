#!/usr/bin/env python3
"""Makes the captures of the suite: rendered videos and photos with exact truth.

    suite.py SHARED [NAME ...] [--small] [--list] [--cache FOLDER]

NAME is a part of captures' names (`mockup-yaw`, `-tumble-sun-15`). A capture that is there is not
made again; the folder of each is printed. See data/README.md.
"""
import argparse
import os
import shutil
import signal
import subprocess
import sys

import captures
import film

HERE = os.path.dirname(os.path.abspath(__file__))


def cache_folder():
    """Outside the repository: XDG_CACHE_HOME/sat-recon/suite."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return os.path.join(base, "sat-recon/suite")


def install_three(cache):
    """three.js from npm, as package-lock.json pins it, in the cache."""
    web = os.path.join(cache, "web")
    lock = os.path.join(HERE, "web/package-lock.json")
    if os.path.isfile(f"{web}/done") and os.path.getmtime(f"{web}/done") > os.path.getmtime(lock):
        return
    os.makedirs(web, exist_ok=True)
    for name in ("package.json", "package-lock.json"):
        shutil.copy(os.path.join(HERE, "web", name), web)
    subprocess.run(["npm", "ci", "--no-audit", "--no-fund", "--loglevel=error"], cwd=web, check=True, stdout=sys.stderr)
    open(f"{web}/done", "w").close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shared")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--small", action="store_true", help="only the first few captures of each class")
    parser.add_argument("--list", action="store_true", help="print the names and make nothing")
    parser.add_argument("--cache", default=cache_folder())
    args = parser.parse_args()
    chosen = captures.selected(args.names, args.small) + captures.extra(args.names)
    if not chosen:
        parser.error("no capture has such a name (--list names them)")
    if args.list:
        print("\n".join(c.name for c in chosen))
        return 0
    install_three(args.cache)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the browser is ended, too
    failed = 0
    for capture in chosen:
        try:
            folder, count, seconds = film.film(capture, args.cache, args.shared)
        except (RuntimeError, FileNotFoundError) as error:
            print(f"{capture.name}: {error}", file=sys.stderr, flush=True)
            failed += 1
            continue
        made = f" ({count} frames, {count / seconds:.1f} a second)" if count else ""
        print(folder + made, flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
