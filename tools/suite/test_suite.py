"""The suite's own arithmetic: motions, truth, sensor, judge.

    python3 -m unittest discover -s tools/suite
"""

import itertools
import json
import math
import os
import tempfile
import unittest

import numpy as np

import captures
import film
import judge
import judge_motion
import motions
import sensor
import suite_tables
import truth


def random_poses(n, seed=1):
    rng = np.random.default_rng(seed)
    return {f"{k:03d}": (motions.random_rotation(rng), rng.normal(size=3)) for k in range(n)}


class Motions(unittest.TestCase):
    def test_a_motor_turns_once_and_evenly(self):
        angles = motions.yaw_angles(10.0, 15)
        self.assertEqual(len(angles), 540)
        np.testing.assert_allclose(np.diff(angles), 10 / 15, atol=1e-12)
        self.assertAlmostEqual(angles[-1] + 10 / 15, 360)

    def test_a_hand_ripples_nearly_stops_and_ends_where_it_says(self):
        for seed in range(20):
            angles = motions.hand_angles(np.random.default_rng(seed), 30, 12.0, 372.0)
            steps = np.diff(angles)
            self.assertAlmostEqual(angles[-1], 372.0)
            self.assertGreater(steps.min(), 0)
            self.assertLess(steps.min(), 0.15 * np.median(steps))
            self.assertLess(steps.max(), 1.3 * np.median(steps))
            self.assertGreater(steps.max(), 1.1 * np.median(steps))

    def test_a_tumble_keeps_energy_and_momentum_whatever_the_step(self):
        inertia, w0 = np.array([1.0, 0.8, 0.5]), np.array([0.6, 0.2, 0.3])
        q, w = motions.tumble(inertia, w0, np.array([1.0, 0, 0, 0]), 15, 8.0)
        energy = (inertia * w * w).sum(axis=1)
        np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
        momentum = np.array([motions.quaternion_matrix(a) @ (inertia * b) for a, b in zip(q, w)])
        np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(q), 1)), atol=1e-9)
        coarse, _ = motions.tumble(inertia, w0, np.array([1.0, 0, 0, 0]), 15, 8.0, step_s=0.001)
        self.assertLess(np.abs(q - coarse).max(), 1e-8)

    def test_the_rates_of_a_tumble_repeat_after_its_period(self):
        for w0 in ([0.7, 0.15, 0.2], [0.1, 0.2, 0.7]):
            inertia = np.array([1.0, 0.8, 0.5])
            period = motions.polhode_period(inertia, np.array(w0))
            _, w = motions.tumble(inertia, np.array(w0), np.array([1.0, 0, 0, 0]), 1 / period, 2.5 * period, step_s=0.02)
            np.testing.assert_allclose(w[1], w0, atol=1e-6)
            _, half = motions.tumble(inertia, np.array(w0), np.array([1.0, 0, 0, 0]), 2 / period, period, step_s=0.02)
            self.assertGreater(np.abs(half[1] - w0).max(), 0.05)

    def test_a_camera_sees_its_target_in_the_middle_and_up_above(self):
        centre, target = np.array([1.0, -2.0, 0.7]), np.array([0.1, 0.2, -0.1])
        R = motions.look_at(centre, target)
        seen = R @ (target - centre)
        np.testing.assert_allclose(seen[:2], 0, atol=1e-12)
        self.assertGreater(seen[2], 0)
        self.assertLess((R @ [0, 0, 1])[1], 0)
        self.assertAlmostEqual(np.linalg.det(R), 1)

    def test_quaternions_and_matrices_are_the_same_rotation(self):
        for seed in range(20):
            R = motions.random_rotation(np.random.default_rng(seed))
            np.testing.assert_allclose(motions.quaternion_matrix(motions.matrix_quaternion(R)), R, atol=1e-12)


class Captures(unittest.TestCase):
    def test_halves_share_nothing_and_names_lead_back(self):
        self.assertFalse(set(captures.HALVES["A"]) & set(captures.HALVES["B"]))
        everything = captures.all_captures()
        self.assertEqual(len(everything), 12 * (4 * 9 + 2 * 3))
        self.assertEqual([captures.parse(c.name) for c in everything], everything)
        self.assertEqual(len({c.key() for c in everything}), len(everything))
        self.assertTrue({captures.parse(n) for n in captures.SMALL} <= set(everything))

    def test_the_same_name_gives_the_same_plan(self):
        capture = captures.parse("iss-hand-low-4")
        self.assertEqual(film.plan_of(capture)[0], film.plan_of(capture)[0])
        other = film.plan_of(captures.parse("iss-hand-low-15"))[0]
        self.assertNotEqual(film.plan_of(capture)[0]["lens"], other["lens"])

    def test_every_object_stays_within_the_picture(self):
        for name, motion in itertools.product(captures.OBJECTS, ("yaw-low-4", "hand-full-4", "tumble-sun-4", "orbit-full", "few-low")):
            capture = captures.parse(f"{name}-{motion}")
            plan, poses, _ = film.plan_of(capture)
            flat, height = captures.SIZES_M[name]
            M, lens = np.array(plan["mount"]).reshape(4, 4).T, plan["lens"]
            a = np.linspace(0, 2 * math.pi, 24)
            rim = np.array([[flat * math.cos(x), flat * math.sin(x), z] for x in a for z in (-height, height)])
            rim *= np.minimum(1, captures.RADIUS_M / np.linalg.norm(rim, axis=1))[:, None]
            corners = rim @ M[:3, :3].T + M[:3, 3]
            for R, t in poses[::7]:
                p = corners @ R.T + t
                x, y = (lens["f"] * p[:, k] / p[:, 2] + lens[c] for k, c in ((0, "cx"), (1, "cy")))
                self.assertTrue(x.min() > 0 and y.min() > 0 and x.max() < 640 and y.max() < 480, capture.name)

    def test_a_turn_goes_about_the_axis_that_is_stated(self):
        for name in ("aura-yaw-full-4", "chair-hand-low-4"):
            _, poses, record = film.plan_of(captures.parse(name))
            turn = poses[5][0] @ poses[0][0].T
            angle = math.radians(record["angles_deg"][5] - record["angles_deg"][0])
            np.testing.assert_allclose(turn, motions.axis_angle(record["axis_camera"], angle), atol=1e-9)

    def test_a_tumble_states_the_rates_of_its_poses(self):
        _, poses, record = film.plan_of(captures.parse("hubble-tumble-sun-30"))
        step = judge.rotation_vector_deg(poses[10][0].T @ poses[11][0]) * 30
        mean = (np.array(record["rates_body_deg_s"][10]) + record["rates_body_deg_s"][11]) / 2
        np.testing.assert_allclose(step, mean, atol=0.05)


class Pictures(unittest.TestCase):
    def test_noise_is_repeatable_and_as_large_as_stated(self):
        light = {"full_well": 2000, "read_noise": 4.0}
        lens = {"f": 500.0, "cx": 100.0, "cy": 80.0}
        eye = sensor.Sensor(200, 160, lens, light, 1.0, [1, 2])
        grey = np.full((160, 200, 3), 0.25, np.float32)
        first = eye.picture(grey, 7)
        np.testing.assert_array_equal(first, eye.picture(grey, 7))
        self.assertFalse(np.array_equal(first, eye.picture(grey, 8)))
        middle = first[70:90, 90:110].astype(float) / 255
        linear = ((middle + 0.055) / 1.055) ** 2.4
        self.assertAlmostEqual(linear.mean(), 0.25, delta=0.002)
        self.assertAlmostEqual(linear.std(), math.sqrt(0.25 / 2000 + (4 / 2000) ** 2), delta=0.001)
        self.assertLess(first[:8, :8].mean(), first[76:84, 96:104].mean())

    def test_blur_keeps_light(self):
        point = np.zeros((9, 9, 3), np.float32)
        point[4, 4] = 1
        self.assertAlmostEqual(float(sensor.blurred(point)[..., 0].sum()), 1, places=5)

    def test_a_dark_object_stays_dark(self):
        light = captures.light_of(captures.parse("bust-yaw-full-4"))
        bright, dark = (np.full((8, 8, 3), x, np.float32) for x in (0.5, 0.01))
        self.assertAlmostEqual(0.5 * sensor.exposure_for([bright], light), light["white"], places=3)
        self.assertLess(0.01 * sensor.exposure_for([dark], light), 0.1 * light["white"])


class Judge(unittest.TestCase):
    def moved(self, poses, degrees, seed=3):
        """The poses in another world, each turned by `degrees` about an axis of its own."""
        rng = np.random.default_rng(seed)
        Q = motions.random_rotation(rng)
        return {n: (motions.axis_angle(rng.normal(size=3), math.radians(degrees)) @ R @ Q, 3 * t) for n, (R, t) in poses.items()}

    def test_a_model_in_another_world_and_scale_is_right(self):
        true = random_poses(20)
        record = judge.judge(self.moved(true, 0), true, 20)
        self.assertFalse(record["wrong"])
        self.assertLess(record["rotation_max_deg"], 1e-5)
        self.assertGreater(record["auc_1"], 99.9)

    def test_errors_are_as_large_as_they_were_made(self):
        true = random_poses(60)
        record = judge.judge(self.moved(true, 1.0), true, 60)
        self.assertAlmostEqual(record["rotation_median_deg"], 1.0, delta=0.1)
        self.assertFalse(record["wrong"])
        self.assertTrue(judge.judge(self.moved(true, 8.0), true, 60)["wrong"])

    def test_an_eighth_of_the_images_elsewhere_makes_a_model_wrong(self):
        true = random_poses(40)
        found = self.moved(true, 0)
        for name in list(found)[:5]:
            found[name] = (motions.axis_angle([0, 0, 1], 1.0) @ found[name][0], found[name][1])
        record = judge.judge(found, true, 40)
        self.assertTrue(record["wrong"])
        self.assertLess(record["pairs_median_deg"], 0.01)

    def test_photos_of_two_objects_in_one_model_are_wrong_and_of_one_are_right(self):
        a, b = random_poses(10, 4), {"b" + n: p for n, p in random_poses(10, 5).items()}
        both = {"a": a, "b": b}
        self.assertFalse(judge.judge_any(self.moved(a, 0), both, 20)["wrong"])
        self.assertTrue(judge.judge_any(self.moved(a, 0) | self.moved(b, 0, 9), both, 20)["wrong"])

    def test_deviations_are_compared_in_the_frame_of_the_camera(self):
        true = random_poses(300)
        rng, stated, found = np.random.default_rng(8), [], {}
        for k, (name, (R, t)) in enumerate(true.items()):
            sigma = np.array([0.1, 0.4, 0.02]) * (k > 0)
            error = rng.normal(size=3) * np.radians(sigma)
            size = np.linalg.norm(error)
            found[name] = ((motions.axis_angle(error, size) if size else np.eye(3)) @ R, t)
            stated.append({"name": name + ".png", "rotation_deg": sigma.tolist()})
        ratios = np.array(judge.deviation_ratios(found, true, stated))
        self.assertEqual(len(ratios), 3 * 299)
        self.assertAlmostEqual((ratios < 1).mean(), 0.683, delta=0.05)
        self.assertAlmostEqual((ratios < 2).mean(), 0.954, delta=0.03)

    def test_truth_survives_being_written(self):
        poses = random_poses(5)
        with tempfile.TemporaryDirectory() as folder:
            truth.write_model(folder, "RADIAL 640 480 500 320 240 0 0", [n + ".png" for n in poses], list(poses.values()))
            self.assertTrue(os.path.isfile(os.path.join(folder, "points3D.txt")))
            back = judge.read_model(folder)
        for name, (R, t) in poses.items():
            np.testing.assert_allclose(back[name][0], R, atol=1e-9)
            np.testing.assert_allclose(back[name][1], t, atol=1e-9)


class EveryFrame(unittest.TestCase):
    def test_frames_are_found_by_their_times_and_judged_beside_their_deviations(self):
        rng, fps, frames, true = np.random.default_rng(4), 15, [], {}
        world = motions.random_rotation(rng)
        for k in range(200):
            R = motions.random_rotation(rng)
            true[f"frame_{k:06d}"] = (R, np.zeros(3))
            error = rng.normal(size=3) * np.radians(0.2) * (k > 0)
            size = np.linalg.norm(error)
            found = (motions.axis_angle(error, size) if size else np.eye(3)) @ R @ world
            if k % 3 != 1:
                frames.append({"time_s": k / fps, "rotation": list(motions.matrix_quaternion(found)),
                               "rotation_deviation_deg": [0.2 * (k > 0) + 1e-9] * 3})
        with tempfile.TemporaryDirectory() as folder:
            truth.write_model(folder, "RADIAL 640 480 500 320 240 0 0", [n + ".png" for n in true], list(true.values()))
            with open(os.path.join(folder, "frames.json"), "w") as file:
                json.dump({"frames": frames}, file)
            record = judge_motion.every_frame(folder, folder, fps)
        self.assertEqual((record["frames"], record["frames_total"]), (len(frames), 200))
        # The length of three normal errors of one deviation has a median of 1.54 of it.
        self.assertAlmostEqual(record["frames_median_deg"], 1.54 * 0.2, delta=0.06)
        self.assertAlmostEqual(record["frames_error_over_deviation"], 1.54 / math.sqrt(3), delta=0.12)

    def test_a_report_is_compared_with_the_motion(self):
        tilt = math.radians(2)
        said = {"rate_deg_s": {"value": -10.1}, "axis_camera": [0, math.cos(tilt), math.sin(tilt)],
                "tumble": {"inertia_ratios": [{"value": 0.44}, {"value": 0.8}]}}
        true = {"type": "tumble", "rate_deg_s": 10.0, "momentum_camera": [0, -3.0, 0], "inertia": [4.0, 2.0, 5.0]}
        record = judge_motion.report({"poses": {"motion": said}}, true)
        self.assertAlmostEqual(record["rate_error_percent"], 1.0)
        self.assertAlmostEqual(record["axis_error_deg"], 2.0)
        self.assertAlmostEqual(record["inertia_error_percent"], 10.0)
        self.assertEqual(judge_motion.report({}, true), {})


class Tables(unittest.TestCase):
    def test_a_wrong_model_that_is_said_to_be_right_fails(self):
        row = {"capture": "wrong/x", "tool": "sat-recon", "group": "wrong", "half": "-", "asked": "right", "total": 9, "registered": 9,
               "model": "wrong", "stated": "well", "cpu_s": 1.0, "lights": [], "pairs_median_deg": 30.0}
        self.assertIn("**fails**", suite_tables.tables([row]))
        self.assertNotIn("**fails**", suite_tables.tables([row | {"stated": "doubtful"}]))
        self.assertNotIn("**fails**", suite_tables.tables([row | {"model": "right"}]))


if __name__ == "__main__":
    unittest.main()
