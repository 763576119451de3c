"""What the scenes share: the folder that a scene fills, and frames of the sample."""
import os
import shutil
import subprocess
from dataclasses import dataclass
from typing import Callable

import harness
import photos

SIZE = (240, 180)
SOURCES = {}


@dataclass
class Scene:
    """A degenerate scene: what it is, how it is made, and what the right answer is."""

    what: str
    codes: list
    words: list
    is_fast: bool
    make: Callable


def prepare(data, out):
    """Cuts the frames that scenes are made of."""
    os.makedirs(out, exist_ok=True)
    SOURCES["data"] = data
    scale = f"scale={SIZE[0]}:{SIZE[1]}"
    SOURCES["arc"] = harness.frames(os.path.join(data, "sample/orbit.mp4"), os.path.join(out, "arc"), scale, 8)
    SOURCES["other"] = harness.frames(os.path.join(data, "testbed/case3/video.mp4"), os.path.join(out, "other"), scale, 8)


class Made:
    """A scene in the making."""

    def __init__(self, folder, rng, program):
        self.folder, self.rng, self.program = folder, rng, program
        self.frames = {}  # {stem: frame of the sample}: the poses are known
        self.more = {}  # of harness.run

    def path(self, *parts):
        path = os.path.join(self.folder, *parts)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        return path

    def photos(self, pictures, name="photo_{:02}.png"):
        """Arrays as PNG in photos/."""
        for k, picture in enumerate(pictures):
            photos.write_png(self.path("photos", name.format(k)), picture)
        return self.path("photos")

    def arc(self, count=8, known=True):
        """Frames of the sample, 5° apart, in photos/; the paths."""
        paths = []
        for k in range(count):
            shutil.copy(os.path.join(SOURCES["arc"], f"{k + 1:03}.png"), self.path("photos", f"{k + 1:03}.png"))
            paths.append(self.path("photos", f"{k + 1:03}.png"))
            if known:
                self.frames[f"{k + 1:03}"] = k
        return paths

    def pixels(self, count=8, source="arc"):
        """The same as arrays."""
        command = ["ffmpeg", "-v", "error", "-i", os.path.join(SOURCES[source], "%03d.png"), "-frames:v", str(count)]
        return self.decoded(command, SIZE)

    def decoded(self, command, size):
        import numpy as np

        raw = subprocess.run([*command, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"], check=True, capture_output=True, stdin=subprocess.DEVNULL)
        return np.frombuffer(raw.stdout, np.uint8).reshape(-1, size[1], size[0], 3)

    def ffmpeg(self, *arguments):
        subprocess.run(["ffmpeg", "-v", "error", "-y", *arguments], check=True, stdin=subprocess.DEVNULL)

    def write(self, name, content):
        with open(self.path(name), "wb") as file:
            file.write(content if isinstance(content, bytes) else content.encode())
        return self.path(name)
