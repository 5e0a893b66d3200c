"""Tests of poses.py and pose_errors.py on synthetic cameras."""

import contextlib
import io
import json
import tempfile
import unittest
import unittest.mock
from pathlib import Path

import numpy as np

import pose_errors
import poses


def turned(axis, degrees):
    """A rotation about an axis."""
    half = np.radians(degrees) / 2
    return pose_errors.rotation(np.cos(half), *(np.sin(half) * np.array(axis) / np.linalg.norm(axis)))


def ring(count):
    """{name: (rotation, centre)} once around the origin."""
    cameras = {}
    for index in range(count):
        angle = 2 * np.pi * index / count
        centre = np.array([4 * np.cos(angle), 0.3 * index, 4 * np.sin(angle)])
        cameras[f"{index:03}"] = (turned((0, 1, 0.2), 360 * index / count), centre)
    return cameras


def moved(cameras):
    """The same cameras in another world."""
    turn, shift, scale = turned((1, 2, 3), 40), np.array([5.0, -1.0, 2.0]), 0.37
    return {name: (r @ turn.T, scale * turn @ c + shift) for name, (r, c) in cameras.items()}


class Errors(unittest.TestCase):
    def test_another_world_is_no_error(self):
        true = ring(9)
        for away, degrees in pose_errors.judged(moved(true), true).values():
            self.assertLess(away, 1e-9)
            self.assertLess(degrees, 1e-4)

    def test_wrong_views_are_told_and_do_not_spoil_the_others(self):
        true = ring(9)
        estimated = moved(true)
        for name in ("002", "005", "006"):
            rotation, centre = estimated[name]
            estimated[name] = (rotation @ turned((0, 1, 0), 30), centre + 3)
        errors = pose_errors.judged(estimated, true)
        wrong = {name for name, error in errors.items() if pose_errors.is_wrong(error)}
        self.assertEqual(wrong, {"002", "005", "006"})
        self.assertTrue(all(pose_errors.is_good(error) for name, error in errors.items() if name not in wrong))

    def test_a_slightly_turned_view_is_neither_good_nor_wrong(self):
        true = ring(9)
        estimated = moved(true)
        estimated["004"] = (turned((1, 0, 0), 4.5) @ estimated["004"][0], estimated["004"][1])
        error = pose_errors.judged(estimated, true)["004"]
        self.assertAlmostEqual(error[1], 4.5, places=3)
        self.assertFalse(pose_errors.is_good(error) or pose_errors.is_wrong(error))

    def test_a_single_view_has_no_place(self):
        true = ring(5)
        self.assertEqual(pose_errors.judged({"001": true["001"]}, true), {"001": (np.inf, 180.0)})

    def test_both_files_tell_the_same_camera(self):
        rotation, centre = turned((1, 1, 0), 25), np.array([1.0, 2.0, 3.0])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ centre
        of_fled = pose_errors.of_fled({"views": [{"name": "a", "camera": {"world_to_camera": matrix.T.ravel().tolist()}}]})
        half = np.radians(25) / 2
        quaternion = [np.cos(half), np.sin(half) / 2**0.5, np.sin(half) / 2**0.5, 0.0]
        numbers = " ".join(repr(float(value)) for value in [*quaternion, *matrix[:3, 3]])
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "images.txt"
            path.write_text(f"# Image list\n1 {numbers} 1 a.png\n10.0 20.0 -1\n")
            of_colmap = pose_errors.of_colmap_text(path)
        for one in (of_fled, of_colmap):
            self.assertTrue(np.allclose(one["a"][0], rotation) and np.allclose(one["a"][1], centre))


def poses_json(cameras, low_confidence=False):
    views = []
    for name, (rotation, centre) in cameras.items():
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ centre
        views.append({"name": name, "camera": {"world_to_camera": matrix.T.ravel().tolist()}})
    return {"views": views, "low_confidence": low_confidence, "rung": "L"}


class Scores(unittest.TestCase):
    def test_wrong_views_count_as_unwarned_only_where_the_capture_is_trusted(self):
        true = ring(8)
        estimated = moved(true)
        estimated["003"] = (estimated["003"][0], estimated["003"][1] + 2)
        trusted = poses.score(poses_json(estimated), true, 8)
        self.assertEqual([trusted[key] for key in ("registered", "good", "wrong", "unwarned")], [8, 7, 1, 1])
        doubted = poses.score(poses_json(estimated, low_confidence=True), true, 8)
        self.assertEqual([doubted["wrong"], doubted["unwarned"]], [1, 0])

    def test_no_poses_are_a_row(self):
        figures = poses.score(None, ring(8), 8)
        self.assertEqual([figures["photographs"], figures["registered"], figures["rms"]], [8, 0, None])

    def test_the_table_sums_its_cells(self):
        found = poses.score(poses_json(moved(ring(8))), ring(8), 8) | {"seconds": 12.0}
        none = poses.score(None, ring(8), 8) | {"seconds": 30.0}
        text = poses.table({"a": {"learned features": found}, "b": {"learned features": none}}, ["learned features"])
        self.assertIn("| a | 8 | 8 good (0.00 %), 0 wrong, strategy L, 12 s |", text)
        self.assertIn("| b | 8 | 0 good, 0 wrong, strategy -, 30 s |", text)
        self.assertIn("| all 2 | 16 | 8 good, 0 wrong (0 without a warning), 42 s |", text)


class Runs(unittest.TestCase):
    def test_a_cell_is_run_once_and_its_record_read_after_that(self):
        with tempfile.TemporaryDirectory() as name:
            top = Path(name)
            true = ring(6)
            sparse = top / "sharp" / "room" / "sparse"
            sparse.mkdir(parents=True)
            # The tool reads only names here.
            sparse.joinpath("images.txt").write_text("")
            cell = top / "room-1"
            (cell / "images").mkdir(parents=True)
            for stem in true:
                (cell / "images" / f"{stem}.png").write_bytes(b"")
            (cell / "degrade.json").write_text(json.dumps({"sharp": "room"}))
            program = top / "fled"
            calls = top / "calls"
            program.write_text(f"#!/bin/sh\necho \"$@\" >> {calls}\nexit 3\n")
            program.chmod(0o755)
            arguments = [
                "poses.py", str(cell), "--fled", str(program), "--sharp", str(top / "sharp"), "--out", str(top / "out"),
            ]
            for _ in range(2):
                with unittest.mock.patch("sys.argv", arguments), contextlib.redirect_stdout(io.StringIO()) as out:
                    with contextlib.redirect_stderr(io.StringIO()):
                        poses.main()
            self.assertIn("| room-1 | 6 | 0 good", out.getvalue())
            lines = calls.read_text().splitlines()
            self.assertEqual(len(lines), 2)
            self.assertIn("--matcher none", lines[0])
            self.assertNotIn("--matcher", lines[1])


if __name__ == "__main__":
    unittest.main()
