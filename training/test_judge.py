"""Checks of the judge: python -m unittest test_judge"""

import contextlib
import io
import json
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import numpy as np
from PIL import Image

import judge
import judge_three
import published
import strange


def columns(**changed):
    """Properties of one red, round, nearly opaque Gaussian three units in front of the camera."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    values = dict.fromkeys(names, 0.0) | {"z": 3.0, "rot_0": 1.0, "opacity": 2.0}
    values |= {"f_dc_0": 1.0, "f_dc_1": -2.0, "f_dc_2": -2.0} | {f"scale_{n}": np.log(0.1) for n in range(3)}
    return {name: np.atleast_1d(value) for name, value in (values | changed).items()}


def entry(name="one", size=33, focal=60.0):
    pose = np.eye(4).tolist()
    return {
        "name": name, "width": size, "height": size, "fx": focal, "fy": focal, "cx": size / 2, "cy": size / 2,
        "world_to_camera": pose,
    }


def read(values):
    with tempfile.TemporaryDirectory() as folder:
        strange.write_ply(Path(folder) / "scene.ply", values)
        return published.read_scene(Path(folder) / "scene.ply")


def render(**changed):
    return published.render(read(columns(**changed)), published.camera(entry()))


class LikeThree(unittest.TestCase):
    def test_one_gaussian_ends_at_two_standard_deviations_and_keeps_its_light(self):
        scene, camera = read(columns()), published.camera(entry())
        image = judge_three.draw(scene, camera, 0.01, 10)
        before = (60 * 0.1 / 3) ** 2
        variance = before + published.LOW_PASS
        peak = (0.5 + np.sqrt(1 / (4 * np.pi))) / (1 + np.exp(-2)) * before / variance
        self.assertAlmostEqual(float(image[16, 16, 0]), peak, places=6)
        reach = int(2 * np.sqrt(variance))
        self.assertAlmostEqual(float(image[16, 16 + reach, 0]), peak * np.exp(-0.5 * reach**2 / variance), places=6)
        self.assertEqual(float(image[16, 17 + reach].sum()), 0)

    def test_bins_come_nearest_first_and_within_one_the_last_first(self):
        self.assertEqual(judge_three.order(np.array([9.0, 5.0, 1.0, 5.0001]), 0, 10).tolist(), [2, 3, 1, 0])


class Formulas(unittest.TestCase):
    def test_one_gaussian_is_its_closed_form(self):
        image = render()
        variance = (60 * 0.1 / 3) ** 2 + published.LOW_PASS
        colour, opacity = 0.5 + np.sqrt(1 / (4 * np.pi)), 1 / (1 + np.exp(-2))
        for x in (16, 19):
            expected = colour * opacity * np.exp(-0.5 * (x - 16) ** 2 / variance)
            self.assertAlmostEqual(float(image[16, x, 0]), expected, places=6)
        self.assertEqual(float(image[0, 0].sum()), 0, "below 1/255 nothing is blended")
        self.assertEqual(float(image[..., 1:].max()), 0, "no colour is below 0")

    def test_alpha_ends_at_its_cap(self):
        colour = 0.5 + np.sqrt(1 / (4 * np.pi))
        self.assertAlmostEqual(float(render(opacity=20.0)[16, 16, 0]), 0.99 * colour, places=6)

    def test_what_is_behind_is_hidden_and_what_would_leave_too_little_is_not_blended(self):
        green = dict(f_dc_0=[1.0, -2.0, -2.0], f_dc_1=[-2.0, 1.0, 1.0], z=[3.0, 3.1, 3.2], opacity=[20.0, 2.0, 20.0])
        alone = {name: np.broadcast_to(value, 3) for name, value in columns().items()}
        image = published.render(read(alone | {k: np.array(v) for k, v in green.items()}), published.camera(entry()))
        colour, middle = 0.5 + np.sqrt(1 / (4 * np.pi)), 1 / (1 + np.exp(-2))
        # The third would leave 0.01 (1 - middle) 0.01 < 1e-4.
        self.assertAlmostEqual(float(image[16, 16, 1]), 0.01 * middle * colour, places=6)

    def test_behind_the_camera_is_nothing(self):
        self.assertEqual(float(render(z=-3.0).sum()), 0)

    def test_harmonics_are_orthonormal_and_the_first_degree_is_minus_y_z_minus_x(self):
        z, weights = np.polynomial.legendre.leggauss(8)
        angle = np.arange(16) * 2 * np.pi / 16
        ring = np.sqrt(1 - z**2)[:, None]
        directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z[:, None] + 0 * angle], -1)
        basis = published.harmonic_basis(3, directions.reshape(-1, 3))
        area = np.repeat(weights * 2 * np.pi / 16, 16)
        np.testing.assert_allclose((basis.T * area) @ basis, np.eye(16), atol=1e-12)
        first = published.harmonic_basis(1, np.array([[0.6, 0.0, 0.8]]))[0, 1:]
        np.testing.assert_allclose(first, 0.4886025119029199 * np.array([0.0, 0.8, -0.6]), atol=1e-12)

    def test_a_quarter_turn_about_z_turns_x_to_y(self):
        half = np.sqrt(0.5)
        turned = published.rotation_matrices(np.array([[half, 0, 0, half]]))[0]
        np.testing.assert_allclose(turned @ [1.0, 0, 0], [0.0, 1, 0], atol=1e-12)


class Files(unittest.TestCase):
    def test_the_header_says_where_a_property_is(self):
        values = columns(x=0.5)
        backwards = dict(reversed(list(values.items())))
        np.testing.assert_array_equal(read(backwards).means, read(values).means)

    def test_higher_harmonics_are_by_channel(self):
        scene = read(columns() | {f"f_rest_{n}": np.array([float(n)]) for n in range(9)})
        self.assertEqual(scene.harmonics[0, 1:].tolist(), [[0, 3, 6], [1, 4, 7], [2, 5, 8]])

    def test_a_file_that_is_cut_or_goes_on_is_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "scene.ply"
            strange.write_ply(path, columns())
            whole = path.read_bytes()
            for changed in (whole[:-1], whole + b"0", b"plain words\n"):
                path.write_bytes(changed)
                with self.assertRaisesRegex(ValueError, "scene.ply"):
                    published.read_scene(path)

    def test_a_missing_property_is_refused(self):
        values = columns()
        del values["rot_3"]
        with self.assertRaisesRegex(ValueError, "no property rot_3"):
            read(values)


class Judge(unittest.TestCase):
    """On twelve Gaussians, by the files that the command line sees."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.run = Path(folder.name)
        self.columns = strange.gaussians(seed=1, count=12)
        camera = {**entry("front", 48, 50.0), "world_to_camera": strange.camera("front", 0, (0, 0, -4))["world_to_camera"]}
        (self.run / "cameras.json").write_text(json.dumps([camera]))
        strange.write_ply(self.run / "scene.ply", self.columns)
        image = published.render(published.read_scene(self.run / "scene.ply"), published.camera(camera)).clip(0, 1)
        Image.fromarray(np.rint(image * 255).astype(np.uint8)).save(self.run / "front.png")

    def verdict(self):
        """What the command prints, or why it fails."""
        printed = io.StringIO()
        with mock.patch("sys.argv", ["judge.py", str(self.run), str(self.run)]), contextlib.redirect_stdout(printed):
            judge.main()
        return printed.getvalue()

    def test_the_good_scene_passes(self):
        self.assertIn("| front | ", self.verdict())

    def test_a_file_with_its_quaternions_swapped_is_condemned(self):
        w, x, y, z = (self.columns[f"rot_{n}"] for n in range(4))
        strange.write_ply(self.run / "scene.ply", self.columns | {"rot_0": x, "rot_1": y, "rot_2": z, "rot_3": w})
        with self.assertRaisesRegex(SystemExit, r"front: \d\d\.\d\d dB, 45 wanted"):
            self.verdict()

    def test_a_shift_by_half_a_pixel_is_condemned(self):
        camera = json.loads((self.run / "cameras.json").read_text())[0]
        (self.run / "cameras.json").write_text(json.dumps([{**camera, "cx": camera["cx"] + 0.5}]))
        with self.assertRaisesRegex(SystemExit, "45 wanted"):
            self.verdict()

    def test_another_cap_of_alpha_is_condemned_though_the_mean_hardly_sees_it(self):
        with mock.patch.object(published, "ALPHA_MOST", 0.97), self.assertRaisesRegex(SystemExit, "a grey level off"):
            self.verdict()

    def test_round_gaussians_cannot_show_that_the_order_matters(self):
        flat = judge.Verdict("front", 58.9, 0.0, 0.002)
        self.assertEqual(len(judge.objections([flat], [flat])), 1)

    def test_no_pictures_and_pictures_of_another_size_are_refused(self):
        (self.run / "front.png").rename(self.run / "front.jpg")
        with self.assertRaisesRegex(SystemExit, "no pictures"):
            self.verdict()
        Image.new("RGB", (4, 4)).save(self.run / "front.png")
        with self.assertRaisesRegex(SystemExit, "expected"):
            self.verdict()


if __name__ == "__main__":
    unittest.main()
