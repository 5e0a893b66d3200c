"""The twins agree on the light."""

import struct
import unittest

import numpy as np

import raw_twins


class RawTwins(unittest.TestCase):
    def setUp(self):
        self.light = np.full((64, 96, 3), 1 / 60)
        self.codes = raw_twins.exposed(self.light, np.random.default_rng(1))

    def test_codes_have_the_light_in_the_mean_and_noise_on_both_sides_of_black(self):
        white = raw_twins.WHITE - raw_twins.BLACK
        for channel in range(3):
            samples = self.codes[raw_twins.mosaic(self.codes.shape) == channel]
            share = (samples.mean() - raw_twins.BLACK) / white / raw_twins.NEUTRAL[channel]
            self.assertAlmostEqual(share, 1 / 60, delta=2e-4)
        black = raw_twins.exposed(0 * self.light, np.random.default_rng(1))
        self.assertLess(black.min(), raw_twins.BLACK)
        self.assertAlmostEqual(black.mean(), raw_twins.BLACK, delta=0.1)

    def test_a_dng_ends_with_its_samples_where_its_strip_begins(self):
        file = raw_twins.dng(self.codes, 1 / 30)
        count = struct.unpack_from("<H", file, 8)[0]
        entries = [struct.unpack_from("<HHII", file, 10 + 12 * index) for index in range(count)]
        self.assertEqual([entry[0] for entry in entries], sorted(entry[0] for entry in entries))
        (strip,) = [entry[3] for entry in entries if entry[0] == 273]
        self.assertEqual(file[strip:], self.codes.astype("<u2").tobytes())

    def test_a_jpeg_is_dark_and_has_no_colour_of_its_own(self):
        picture = raw_twins.camera_jpeg(self.codes)
        expected = 255 * raw_twins.to_srgb(1 / 60)
        np.testing.assert_allclose(picture[16:-16, 16:-16].mean(axis=(0, 1)), expected, atol=3)


if __name__ == "__main__":
    unittest.main()
