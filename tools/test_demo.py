"""Tests of demo.py: its picture, and its arguments."""

import unittest

from PIL import Image

import demo


class Pictures(unittest.TestCase):
    def test_pictures_stand_side_by_side_with_white_between_them(self):
        row = demo.beside([Image.new("RGB", (3, 4), "red"), Image.new("RGB", (5, 4), "blue")])
        self.assertEqual(row.size, (3 + demo.GAP + 5, 4))
        middle = [row.getpixel((x, 2)) for x in (2, 3, 2 + demo.GAP, 3 + demo.GAP)]
        red, white, blue = (255, 0, 0), (255, 255, 255), (0, 0, 255)
        self.assertEqual(middle, [red, white, white, blue])

    def test_pictures_of_different_heights_are_refused(self):
        with self.assertRaisesRegex(ValueError, r"\[4, 5\]"):
            demo.beside([Image.new("RGB", (3, 4)), Image.new("RGB", (3, 5))])


class Options(unittest.TestCase):
    def test_a_value_is_json_where_it_can_be_and_else_a_word(self):
        self.assertEqual([demo.number(text) for text in ("2", "false", "kernel")], [2, False, "kernel"])


if __name__ == "__main__":
    unittest.main()
