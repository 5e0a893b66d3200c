"""Tests of peers.py: reading scene.ply and a summary, and their differences."""

import math
import struct
import sys
import tempfile
import unittest
from pathlib import Path

import formats
import numpy as np
import peers

SUMMARY = """# Summary

**Row Count:** 2

| Column  | min      | max      | median | mean | stdDev | nans | infs | histogram |
|---------|----------|----------|--------|------|--------|------|------|-----------|
| x       | -1.5     | 2.25     | 0      | 0    | 1      | 0    | 0    | ▁ ▁       |
| opacity | 0.119203 | 0.880797 | 0.5    | 0.5  | 1      | 0    | 0    | ▁ ▁       |
| scale_0 | 0.135335 | 1        | 0.5    | 0.5  | 1      | 0    | 0    | ▁ ▁       |
"""


class SplatTransform(unittest.TestCase):
    def setUp(self):
        head = "ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
        head += "".join(f"property float {name}\n" for name in ("x", "opacity", "scale_0")) + "end_header\n"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.ply"
            path.write_bytes(head.encode() + struct.pack("<6f", -1.5, 2.0, 0.0, 2.25, -2.0, -2.0))
            self.ours = peers.own_bounds(path)

    def objections(self, old="", new=""):
        return peers.objections(peers.read_summary(SUMMARY.replace(old, new) if old else SUMMARY), *self.ours)

    def test_bounds_are_of_what_the_values_mean(self):
        count, bounds = self.ours
        self.assertEqual((count, bounds["x"]), (2, (-1.5, 2.25)))
        self.assertAlmostEqual(bounds["scale_0"][0], math.exp(-2))
        self.assertAlmostEqual(bounds["opacity"][1], 1 / (1 + math.exp(-2)))

    def test_what_agrees_meets_no_objection(self):
        self.assertEqual(self.objections(), [])

    def test_another_count_is_condemned(self):
        self.assertEqual(self.objections("Count:** 2", "Count:** 3"), ["3 Gaussians, we count 2"])

    def test_another_bound_is_condemned(self):
        self.assertEqual(len(self.objections("2.25", "2.2501")), 1)
        self.assertEqual(len(self.objections("0.880797", "2")), 1)

    def test_slack_is_given_where_it_is_said_and_no_further(self):
        summary = peers.read_summary(SUMMARY.replace("0.880797", "0.884").replace("2.25", "2.253"))
        self.assertEqual(len(peers.objections(summary, *self.ours, {"opacity": 0.004})), 1)
        self.assertEqual(len(peers.objections(summary, *self.ours, {"opacity": 0.002})), 2)

    def test_what_is_no_number_is_condemned(self):
        self.assertEqual(len(self.objections("| 1      | 0    | 0    |", "| 1      | 1    | 0    |")), 3)

    def test_another_property_is_condemned(self):
        self.assertEqual(len(self.objections("scale_0", "scale_1")), 1)

    def test_no_summary_at_all_is_condemned(self):
        with self.assertRaisesRegex(SystemExit, "nothing of a count"):
            peers.read_summary("")


class Nodes(unittest.TestCase):
    def test_a_node_that_turns_the_wrong_way_does_not_level_the_cameras(self):
        sine, cosine = np.sin(np.radians(20)), np.cos(np.radians(20))
        node = np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        # Right is (cos 20, -sin 20) where y points up; in the world of the poses it points down.
        cameras = [{"world_to_camera": [[cosine, sine, 0, 0]]}] * 3
        self.assertAlmostEqual(formats.tilt(node, cameras), 0)
        self.assertAlmostEqual(formats.tilt(np.eye(4), cameras), 20)
        self.assertAlmostEqual(formats.tilt(node.T, cameras), 40)


class Commands(unittest.TestCase):
    def test_a_command_that_fails_ends_all_with_its_last_words(self):
        with self.assertRaisesRegex(SystemExit, "(?s)failed with 3:.*enough"):
            peers.run([sys.executable, "-c", "print('enough'); raise SystemExit(3)"])


if __name__ == "__main__":
    unittest.main()
