"""What of the recipe needs no PyTorch; Rust's own tests have the same numbers of guides, lenses, curves and images."""

import importlib.util
import json
import unittest
from pathlib import Path

import numpy as np

import degrade
import lens
import self_test
import tone_curve


def ramp():
    """A dark photograph with every level of 0..0.2."""
    level = np.linspace(0, 0.2, 128 * 128, dtype=np.float32).reshape(128, 128, 1)
    return level * np.array([1, 0.8, 0.6], np.float32)


class ToneCurve(unittest.TestCase):
    def test_the_histogram_keeps_every_pixel(self):
        self.assertAlmostEqual(tone_curve.histogram([ramp(), ramp()]).sum(), 2 * 128 * 128, places=6)

    def test_the_table_rises_to_one(self):
        for alpha in (0.1, 1, 3, 10):
            lut = tone_curve.table(tone_curve.histogram([ramp()]), alpha)
            self.assertTrue((np.diff(lut) >= 0).all())
            self.assertAlmostEqual(lut[-1], 1, places=9)

    def test_alpha_zero_and_gamma_one_change_nothing(self):
        np.testing.assert_allclose(tone_curve.enhance([ramp()], 0, 1)[0], ramp(), atol=1e-6)

    def test_hue_and_saturation_stay(self):
        bright = tone_curve.enhance([ramp()], 10, 1)[0][64]
        np.testing.assert_allclose(bright[:, 1] / bright[:, 0], 0.8, atol=1e-3)

    def test_the_automatic_target_reaches_its_mean(self):
        bright = tone_curve.enhance([ramp()], *tone_curve.automatic_target([ramp()]))[0]
        self.assertAlmostEqual(float(tone_curve.value(bright).mean()), 0.45, places=3)

    def test_the_golden_numbers_that_the_product_is_held_to_are_those_of_this_curve(self):
        folder = Path(__file__).parent.parent / "tests" / "golden"
        script = importlib.util.spec_from_file_location("golden_tone_curve", folder / "tone_curve.py")
        golden = importlib.util.module_from_spec(script)
        script.loader.exec_module(golden)
        expected = json.loads((folder / "tone_curve.json").read_text())
        for found, curve in zip(golden.golden()["curves"], expected["curves"], strict=True):
            np.testing.assert_allclose(found["values"], curve["values"], atol=1e-6)
        np.testing.assert_allclose(golden.golden()["automatic"], expected["automatic"], atol=1e-6)


class Degradation(unittest.TestCase):
    def test_a_shake_kernel_keeps_light_and_place(self):
        rng = np.random.default_rng(0)
        middle = degrade.MARGIN - 1
        places = np.arange(degrade.KERNEL) - middle
        for extent in (0, 3, 25):
            kernel = degrade.shake_kernel(rng, extent)
            self.assertAlmostEqual(kernel.sum(), 1, places=6)
            self.assertAlmostEqual((kernel.sum(0) * places).sum(), 0, places=5)
            self.assertAlmostEqual((kernel.sum(1) * places).sum(), 0, places=5)

    def test_a_point_kernel_moves_nothing(self):
        image = np.random.default_rng(1).random((96, 80, 3), np.float32)
        point = degrade.deposit(np.zeros((2, 1)))
        again = degrade.convolve(degrade.spectrum(image), point, image.shape[:2])
        np.testing.assert_allclose(again, image, atol=1e-5)

    def test_a_blurred_image_is_not_the_sharp_one(self):
        image = np.random.default_rng(1).random((96, 96, 3), np.float32)
        kernel = degrade.shake_kernel(np.random.default_rng(2), 9)
        again = degrade.convolve(degrade.spectrum(image), kernel, image.shape[:2])
        self.assertGreater(float(np.abs(again - image).mean()), 0.05)

    def test_srgb_comes_back(self):
        levels = np.linspace(0, 1, 256, dtype=np.float32)
        np.testing.assert_allclose(degrade.encode(degrade.decode(levels)), levels, atol=1e-5)


class Guides(unittest.TestCase):
    def test_a_guide_has_the_detail_of_its_render_where_the_two_agree_and_only_there(self):
        # The numbers of the product's own test (pipeline/guide.rs).
        view = np.full((32, 64, 3), 0.5, np.float32)
        render = view + 0.01
        render[16:24:2] += 0.02
        render[:, :24] = 0.1, 0.2, 0.9
        guide = degrade.trusted(view, render)
        self.assertAlmostEqual(float(guide[16, 4, 2]), 0.5, delta=0.01)
        # A stripe is 0.01 above its cell, which is 0.02 above the view's: trusted by exp(-1/4).
        np.testing.assert_allclose(guide[[6, 18, 19, 20], 60, 0], 0.5 + 0.00779 * np.array([0, 1, -1, 1]), atol=1e-4)

    def test_guides_are_the_products(self):
        # The numbers of the product's own test (pipeline/guide.rs).
        x, y, c = np.meshgrid(np.arange(37), np.arange(26), np.arange(3))

        def waves(height, phase):
            return np.clip(0.1 + height * np.sin(0.7 * x + 0.3 * y + c + phase), 0, 1).astype(np.float32)

        guide = degrade.trusted(waves(0.1, 0), waves(0.12, 0.4))
        for (left, top), expected in {
            (0, 0): [0.12484, 0.22331, 0.20543],
            (3, 1): [0.14831, 0.0437, 0.00353],
            (18, 13): [0.0108, 0.00036, 0.088],
            (36, 25): [0.18939, 0.142, 0.05553],
        }.items():
            np.testing.assert_allclose(guide[top, left], expected, atol=1e-4)
        fed = degrade.trusted(waves(0.1, 0), waves(0.12, 0.4), degrade.SHARE)
        np.testing.assert_allclose(fed[1, 3], [0.15408, 0.05293, 0.00392], atol=1e-4)
        tiny = np.full((1, 2, 3), 0.5, np.float32)
        np.testing.assert_array_equal(degrade.trusted(tiny, tiny), tiny)


class Lens(unittest.TestCase):
    def test_a_lens_is_unbent_as_in_the_product(self):
        # The numbers of the product's own test (poses/lens.rs): what is shown is where it came from.
        y, x = np.mgrid[:120, :160].astype(np.float32)
        ramps = np.stack([0.2 + 0.004 * x, 0.2 + 0.004 * y, 0 * x], -1)
        bent = dict(
            intrinsics=dict(fx=150, fy=150, cx=80, cy=60), distortion=dict(model="perspective", radial=[-0.1, 0, 0, 0, 0, 0], tangential=[0, 0])
        )
        found = lens.undistorted(ramps, bent, dict(fx=140, fy=140, cx=80, cy=60))[20, 10]
        np.testing.assert_allclose(found, [0.22985, 0.27423, 0], atol=1e-4)
        with self.assertRaises(SystemExit):
            lens.undistorted(ramps, dict(bent, distortion=dict(model="fisheye", radial=[0.1, 0, 0, 0])), bent["intrinsics"])


class SelfTest(unittest.TestCase):
    def test_the_images_of_the_self_test_are_the_products(self):
        images = self_test.images()
        self.assertEqual(images.shape, (6, self_test.SIDE, self_test.SIDE))
        # As golden.rs has them: column 5 and row 20 lie in different squares, 5 and 3 in one.
        np.testing.assert_allclose(images[:3, 20, 5], [0.2 + 2.5 / 64, 0.2 + 10 / 64, 0.7 - 0.5 * 100 / 4096], atol=1e-6)
        np.testing.assert_allclose(images[:3, 3, 5], [0.4 + 2.5 / 64, 0.4 + 1.5 / 64, 0.7 - 0.5 * 15 / 4096], atol=1e-6)
        np.testing.assert_allclose(images[3:, 5, 20], images[:3, 20, 5], atol=1e-7)


if __name__ == "__main__":
    unittest.main()
