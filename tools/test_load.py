"""Tests of load.py: its statistics, and the form that it sends."""

import tempfile
import unittest
from pathlib import Path

import load


class Measurements(unittest.TestCase):
    def test_a_share_is_a_value_that_was_measured(self):
        values = list(range(100, 0, -1))
        self.assertEqual([load.share(values, part) for part in (0.5, 0.99, 1.0)], [51, 100, 100])
        self.assertEqual(load.share([3.0], 0.99), 3.0)

    def test_a_row_has_the_middle_the_99th_and_the_longest_in_milliseconds(self):
        times = {"/a": [0.001] * 98 + [0.004, 0.25], "/b": [0.002] * 100}
        self.assertEqual(load.row("x", times), "| x | 100 | 1.0 / 250.0 / 250 | 2.0 / 2.0 / 2 |")


class Form(unittest.TestCase):
    def test_every_part_has_its_share_of_all_bytes(self):
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / name for name in ("a.jpg", "b.jpg")]
            for path in paths:
                path.write_bytes(b"picture")
            form = list(load.parts(paths, 1000))
        self.assertEqual([len(content) + rest for _, content, rest in form], [500, 500])
        self.assertIn(b'filename="b.jpg"', form[1][0])


if __name__ == "__main__":
    unittest.main()
