"""A small run, and what can go wrong: of the source tree with the program that ``SAT_RECON`` names,
or of an installed wheel (``SAT_RECON_INSTALLED``, its environment)."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np

INSTALLED = os.environ.get("SAT_RECON_INSTALLED")
DATA = Path(os.environ.get("SAT_RECON_DATA", Path(__file__).resolve().parents[2] / "data"))
if not INSTALLED:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src"))
import sat_recon  # noqa: E402

SMALL = {"frames": 24, "max_size": 240, "iterations": 60, "max_gaussians": 2000}


class Notebooks(unittest.TestCase):
    """The notebooks of docs/notebooks, cell by cell as a kernel runs them."""

    def test_every_cell_runs(self):
        folder = Path(os.environ.get("SAT_RECON_NOTEBOOKS", DATA.parent / "docs/notebooks"))
        notebooks = sorted(folder.glob("*.ipynb"))
        self.assertTrue(notebooks, folder)
        for notebook in notebooks:
            cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
            code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
            self.assertGreater(len(code), 3, notebook)
            with tempfile.TemporaryDirectory() as place:
                script = Path(place) / "notebook.py"
                script.write_text("\n\n".join(code), encoding="utf-8")
                paths = [str(Path(sat_recon.__file__).resolve().parents[1]), os.environ.get("PYTHONPATH", "")]
                environment = {
                    **os.environ,
                    "SAT_RECON_DATA": str(DATA),
                    "PYTHONPATH": os.pathsep.join(filter(None, paths)),
                }
                done = subprocess.run(
                    [sys.executable, "-B", str(script)], cwd=place, env=environment, capture_output=True, text=True
                )
                self.assertEqual(done.returncode, 0, f"{notebook}: {done.stdout}{done.stderr}")
                self.assertIn("Gaussians", done.stdout)


class ASmallRun(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.progress, cls.messages = [], []
        cls.result = sat_recon.reconstruct(
            DATA / "sample/orbit.mp4",
            Path(cls.folder.name) / "out",
            on_progress=cls.progress.append,
            on_message=cls.messages.append,
            **SMALL,
        )

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_poses_are_rigid_and_look_at_the_object(self):
        poses = self.result.camera_from_world
        self.assertEqual(poses.shape, (24, 4, 4))
        self.assertEqual(len(self.result.names), 24)
        rotation = poses[:, :3, :3]
        np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), np.tile(np.eye(3), (24, 1, 1)), atol=1e-9)
        np.testing.assert_allclose(poses @ self.result.world_from_camera, np.tile(np.eye(4), (24, 1, 1)), atol=1e-9)
        # The object alone: the room beyond it is behind some of the cameras.
        near = self.result.points[np.linalg.norm(self.result.points, axis=1) < 0.5]
        self.assertGreater(len(near), 20)
        depth = np.einsum("nj,mj->nm", poses[:, 2, :3], near) + poses[:, 2, 3:]
        self.assertTrue((depth > 0).all())

    def test_points_fall_where_the_program_says(self):
        """Their mean error from the model's files is that of the record."""
        record = self.result.record["poses"]
        self.assertEqual(len(self.result.points), record["points"])
        self.assertEqual(self.result.colors.dtype, np.uint8)
        self.assertAlmostEqual(float(np.median(self.result.errors)), record["mean_error_px"], delta=0.5)
        camera = next(iter(self.result.cameras.values()))
        centre = self.result.camera_from_world[:, :3, 3] @ camera.matrix.T
        pixels = centre[:, :2] / centre[:, 2:]
        inside = (pixels > 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
        self.assertTrue(inside.all(), "the object, the origin, is in every picture")

    def test_the_splat_lies_about_the_origin(self):
        splat = self.result.splat
        self.assertEqual(len(splat), self.result.record["splat"]["gaussians"])
        self.assertTrue((splat.scales > 0).all() and (splat.opacities > 0).all() and (splat.opacities < 1).all())
        self.assertIn(splat.sh.shape[1], (1, 4, 9, 16))
        self.assertLess(float(np.median(np.linalg.norm(splat.means, axis=1))), 3.0)

    def test_the_verdict_and_the_metrics(self):
        self.assertIn(self.result.outcome, ("done", "doubtful"))
        self.assertEqual(self.result.outcome == "doubtful", self.result.verdict == "bad")
        self.assertGreater(self.result.metrics["psnr"], 5.0)
        times = [frame["time_s"] for frame in self.result.frames]
        self.assertEqual(times, sorted(times))
        self.assertGreaterEqual(len(times), 24)

    def test_progress_is_told_by_stage(self):
        stages = {p.stages for p in self.progress}
        self.assertEqual(len(stages), 1)
        self.assertGreater(len({p.stage for p in self.progress}), 2)
        for p in self.progress:
            self.assertTrue(p.total is None or 0 <= p.done <= p.total, p)
        self.assertTrue(any("poses" in m for m in self.messages), self.messages)

    def test_a_folder_is_loaded_again(self):
        again = sat_recon.load(self.result.folder)
        self.assertEqual(again.outcome, self.result.outcome)
        np.testing.assert_array_equal(again.camera_from_world, self.result.camera_from_world)

    def test_the_command_is_the_program(self):
        run = [sys.executable, "-c", "from sat_recon._program import main; main()"]
        if INSTALLED:
            run = [os.path.join(INSTALLED, "bin/sat-recon")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        said = subprocess.run([*run, "--version"], capture_output=True, text=True, env=environment, check=True).stdout
        self.assertIn("sat-recon", said)


class WhatCanGoWrong(unittest.TestCase):
    def test_the_program_s_own_words_are_raised(self):
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(sat_recon.SatReconError, "nowhere.mp4"):
                sat_recon.reconstruct("nowhere.mp4", folder)
            with self.assertRaisesRegex(sat_recon.SatReconError, "no-such-flag"):
                sat_recon.reconstruct("nowhere.mp4", folder, no_such_flag=3)
            with self.assertRaisesRegex(sat_recon.SatReconError, "run.json"):
                sat_recon.load(folder)
        with self.assertRaises(ValueError):
            sat_recon.reconstruct("nowhere.mp4", "out", until="poses")


if __name__ == "__main__":
    unittest.main()
