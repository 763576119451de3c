"""Runs of the program, and their results."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np

from ._files import Camera, Splat, read_cameras, read_images, read_points, read_splat
from ._program import program

# Exit codes of the program that come with a result.
_OUTCOMES = {0: "done", 2: "no model", 3: "doubtful"}
_COMMANDS = ("frames", "sfm", "train", "eval", "report", "run")

PathLike = Union[str, "os.PathLike[str]"]


class SatReconError(RuntimeError):
    """The program failed; the text says what was wrong and what to do."""


@dataclass(frozen=True)
class Progress:
    """How far a stage is."""

    stage: int
    """Number of the stage, from 1."""
    stages: int
    what: str
    """What is done, as ``features``."""
    done: int
    total: Optional[int]
    """``None`` where nobody knows of how many."""
    detail: str


@dataclass(frozen=True)
class Reconstruction:
    """A folder that the program wrote. Arrays are read when they are first asked for."""

    folder: Path
    outcome: str
    """``done``, ``no model``, or ``doubtful``: frames are missing, or the verdict is red."""
    record: dict[str, Any] = field(repr=False)
    """``run.json``: what was decided, with scores, deviations, costs."""

    @property
    def verdict(self) -> str:
        """The worst light: ``good``, ``fair``, ``bad``, or ``unknown``."""
        order = ["unknown", "good", "fair", "bad"]
        return max((light["level"] for light in self.record["verdict"]), key=order.index, default="unknown")

    @property
    def reasons(self) -> list[str]:
        """Why the verdict is not ``good``."""
        doubts = [light for light in self.record["verdict"] if light["level"] in ("fair", "bad")]
        return [f"{light['what']}: {light['reason']}" for light in doubts]

    @cached_property
    def cameras(self) -> dict[int, Camera]:
        """Cameras by number."""
        return read_cameras(self._model("cameras.bin"))

    @cached_property
    def _images(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        return read_images(self._model("images.bin"))

    @property
    def names(self) -> list[str]:
        """Names of the images that have a pose, in the order of all arrays by image."""
        return self._images[0]

    @property
    def camera_numbers(self) -> np.ndarray:
        """For each image the number of its camera, (n,)."""
        return self._images[1]

    @property
    def camera_from_world(self) -> np.ndarray:
        """Poses, (n, 4, 4): x right, y down, z forward, as in OpenCV and COLMAP."""
        return self._images[2]

    @cached_property
    def world_from_camera(self) -> np.ndarray:
        """Their inverses, (n, 4, 4); the last column is the place of the camera."""
        inverse = np.tile(np.eye(4), (len(self.names), 1, 1))
        rotation = np.swapaxes(self.camera_from_world[:, :3, :3], 1, 2)
        inverse[:, :3, :3] = rotation
        inverse[:, :3, 3] = -np.einsum("nij,nj->ni", rotation, self.camera_from_world[:, :3, 3])
        return inverse

    @cached_property
    def _points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return read_points(self._model("points3D.bin"))

    @property
    def points(self) -> np.ndarray:
        """The sparse cloud, (m, 3)."""
        return self._points[0]

    @property
    def colors(self) -> np.ndarray:
        """Its colours, (m, 3), bytes."""
        return self._points[1]

    @property
    def errors(self) -> np.ndarray:
        """Mean reprojection errors of the points, (m,), pixels."""
        return self._points[2]

    @cached_property
    def splat(self) -> Splat:
        """The trained splat."""
        path = self.folder / "splat.ply"
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no splat was trained; run the command 'train' or 'run'")
        return read_splat(path)

    @cached_property
    def metrics(self) -> Optional[dict[str, float]]:
        """Means over the held-out views, ``psnr`` in dB; ``None`` where none were judged."""
        evaluation = self.record.get("evaluation")
        return evaluation["mean"] if evaluation else None

    @cached_property
    def frames(self) -> Optional[list[dict[str, Any]]]:
        """``frames.json`` of a video: time, pose and deviations of every frame; else ``None``."""
        path = self.folder / "frames.json"
        return json.loads(path.read_text(encoding="utf-8"))["frames"] if path.is_file() else None

    def _model(self, name: str) -> Path:
        path = self.folder / "sparse" / "0" / name
        if not path.is_file():
            raise FileNotFoundError(f"{path}: there is no model; the outcome is '{self.outcome}'")
        return path


def load(folder: PathLike) -> Reconstruction:
    """The result in a folder that the program wrote before."""
    path = Path(folder)
    try:
        record = json.loads((path / "run.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SatReconError(f"{path} is not the output folder of a run: it has no run.json") from None
    poses = record.get("poses") or {}
    doubtful = poses.get("missing") or any(light["level"] == "bad" for light in record["verdict"])
    outcome = "no model" if poses.get("no_model") else "doubtful" if doubtful else "done"
    return Reconstruction(path, outcome, record)


def _flags(flags: dict[str, Any]) -> list[str]:
    words = []
    for name, value in flags.items():
        flag = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            words.append(flag)
        elif isinstance(value, (list, tuple)):
            words.append(f"{flag}={','.join(str(v) for v in value)}")
        else:
            words.append(f"{flag}={os.fspath(value) if isinstance(value, os.PathLike) else value}")
    return words


def reconstruct(
    source: PathLike,
    output: PathLike,
    *,
    until: str = "run",
    on_progress: Optional[Callable[[Progress], None]] = None,
    on_message: Optional[Callable[[str], None]] = None,
    **flags: Any,
) -> Reconstruction:
    """Poses, a sparse cloud and a splat of a video or a folder of photos.

    ``source``: what ``sat-recon INPUT`` takes. ``output``: the folder of the results; what it holds
    already is not computed again. ``until``: the command that the run ends with, as ``"sfm"``.
    ``on_progress`` hears how far each stage is, ``on_message`` each line for the user. ``flags``
    are the program's, ``max_size=640`` is ``--max-size 640``; ``True`` stands for a bare flag.

    Ctrl-C stops the program too: it keeps what is finished. A result that is to be doubted is no
    exception: look at ``outcome`` and ``reasons``. Raises :class:`SatReconError` where there is no
    result.
    """
    if until not in _COMMANDS:
        raise ValueError(f"until is one of {', '.join(_COMMANDS)}, not {until!r}")
    words = [program(), until, os.fspath(source), "-o", os.fspath(output), "--progress=json", *_flags(flags)]
    errors, others = [], []
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, encoding="utf-8") as process:
        assert process.stderr is not None
        for line in process.stderr:
            event = _event(line)
            if event["event"] == "progress" and on_progress:
                event.pop("event")
                on_progress(Progress(**event))
            elif event["event"] == "error":
                errors.append(event["text"])
            elif event["event"] == "message":
                others.append(event["text"])
                if on_message:
                    on_message(event["text"])
    if process.returncode not in _OUTCOMES:
        # What is wrong with the flags is told before anything else, as plain text.
        raise SatReconError("\n".join(errors or others) or f"exit code {process.returncode}")
    result = load(output)
    return Reconstruction(result.folder, _OUTCOMES[process.returncode], result.record)


def _event(line: str) -> dict[str, Any]:
    """A line of the program; what a library writes is a message."""
    try:
        event = json.loads(line)
        if isinstance(event, dict) and "event" in event:
            return event
    except ValueError:
        pass
    return {"event": "message", "text": line.rstrip("\n")}
