"""python3 -m unittest discover --start-directory tools"""

import random
import unittest
import zlib

import png


def picture(width, height, seed=0):
    generator = random.Random(seed)
    return width, height, [bytes(generator.randrange(256) for _ in range(3 * width)) for _ in range(height)]


def filtered(kind, row, above):
    """A row of RGB bytes as the format's section 9 filters it."""
    out = bytearray()
    for i, value in enumerate(row):
        a, b, c = (row[i - 3] if i >= 3 else 0), above[i], (above[i - 3] if i >= 3 else 0)
        p = a + b - c
        paeth = a if abs(p - a) <= abs(p - b) and abs(p - a) <= abs(p - c) else b if abs(p - b) <= abs(p - c) else c
        out.append((value - (0, a, b, (a + b) // 2, paeth)[kind]) & 255)
    return bytes([kind]) + bytes(out)


class Png(unittest.TestCase):
    def test_what_is_written_is_read_back(self):
        self.assertEqual(png.read(png.write(*picture(7, 5))), picture(7, 5))

    def test_every_filter_is_undone(self):
        width, height, rows = picture(6, 5)
        above = [bytes(3 * width)] + rows
        raw = b"".join(filtered(kind, row, above[kind]) for kind, row in enumerate(rows))
        plain = png.write(width, height, rows)
        packed = zlib.compress(b"".join(b"\0" + row for row in rows), 9)
        self.assertIn(packed, plain)
        at = plain.index(packed) - 8
        body = zlib.compress(raw)
        data = plain[:at] + len(body).to_bytes(4, "big") + b"IDAT" + body + plain[at + 8 + len(packed):]
        self.assertEqual(png.read(data), (width, height, rows))

    def test_other_files_are_refused(self):
        with self.assertRaises(ValueError):
            png.read(b"\xff\xd8\xff\xe0 a JPEG")

    def test_pictures_stand_side_by_side_and_must_be_of_one_height(self):
        left, right = picture(3, 4), picture(5, 4, seed=1)
        width, height, rows = png.read(png.beside([left, right], gap=2))
        self.assertEqual((width, height), (10, 4))
        self.assertEqual(rows[1], left[2][1] + b"\xff" * 6 + right[2][1])
        with self.assertRaises(ValueError):
            png.beside([left, picture(3, 5)])


if __name__ == "__main__":
    unittest.main()
