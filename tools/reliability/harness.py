"""Runs the program on prepared folders and tells how it ended."""
import os
import shutil
import subprocess
import time

SECONDS = 300  # a run that takes longer counts as a hang


def run(program, arguments, seconds=SECONDS, **more):
    """{"code", "said", "seconds"} of one run; the code is None for a hang, negative for a signal."""
    begun = time.monotonic()
    try:
        done = subprocess.run([program, *arguments], capture_output=True, timeout=seconds, stdin=subprocess.DEVNULL, **more)
        code, said = done.returncode, (done.stdout + done.stderr).decode(errors="replace")
    except subprocess.TimeoutExpired:
        code, said = None, "a hang"
    return {"code": code, "said": said, "seconds": time.monotonic() - begun}


def crashed(told):
    """Whether a run ended in another way than the program's exit codes."""
    return told["code"] not in (0, 1, 2, 3) or "panicked" in told["said"]


def fresh(folder):
    """The folder, empty."""
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    return folder


def frames(video, folder, filters, count=None, first=0):
    """Frames of a video as PNG files 001.png, 002.png ... in a folder."""
    fresh(folder)
    chosen = f"select=gte(n\\,{first})," + filters
    limit = [] if count is None else ["-frames:v", str(count)]
    command = ["ffmpeg", "-v", "error", "-i", video, "-vf", chosen, "-fps_mode", "passthrough", *limit]
    subprocess.run([*command, os.path.join(folder, "%03d.png")], check=True, stdin=subprocess.DEVNULL)
    return folder
