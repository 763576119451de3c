"""The program inside the wheel: where it lies, and how it is run."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path


def program() -> str:
    """Path of the program: ``SAT_RECON``, the wheel's own, or the one on the ``PATH``."""
    named = os.environ.get("SAT_RECON")
    if named:
        return named
    own = Path(__file__).parent / "bin" / "sat-recon"
    if own.is_file():
        return str(own)
    # Of a source tree without a program: not the script that calls this function.
    folders = os.environ.get("PATH", os.defpath).split(os.pathsep)
    scripts = os.path.dirname(os.path.abspath(sys.argv[0]))
    others = os.pathsep.join(f for f in folders if os.path.abspath(f or ".") != scripts)
    found = shutil.which("sat-recon", path=others)
    if found is None:
        raise FileNotFoundError("sat-recon is not on the PATH; build it, or set SAT_RECON to the program")
    return found


def main() -> None:
    """The command ``sat-recon``: the program takes the place of this process."""
    path = program()
    os.execv(path, [path, *sys.argv[1:]])
