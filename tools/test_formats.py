"""Tests of formats.py: what it takes for the same scene, and what not."""

import unittest

import numpy as np

import formats


def scene(seed=1, count=40):
    rng = np.random.default_rng(seed)
    return {
        "position": rng.uniform(-2, 2, (count, 3)),
        "covariance": formats.covariances(rng.normal(0, 1, (count, 4)), rng.uniform(0.1, 0.5, (count, 3))),
        "colour": rng.uniform(0, 1, (count, 3)), "opacity": rng.uniform(0, 1, (count, 1)),
        "harmonics": rng.uniform(-0.9, 0.9, (count, 15, 3)),
    }


class Differences(unittest.TestCase):
    def test_a_scene_has_no_difference_from_itself_and_one_from_another_order(self):
        ours = scene()
        self.assertEqual(set(formats.differences(ours, ours).values()), {0.0})
        apart = formats.differences(ours, {name: values[::-1] for name, values in ours.items()})
        self.assertGreater(min(apart.values()), 0.1)

    def test_the_curve_visits_one_half_of_each_axis_before_the_other(self):
        ours = formats.along_curve(scene(count=500))
        x, y, z = (ours["position"] > np.ptp(ours["position"], axis=0) / 2 + ours["position"].min(axis=0)).T
        octants = (4 * z + 2 * y + x).tolist()
        self.assertEqual(octants, sorted(octants))
        self.assertEqual(set(octants), set(range(8)))

    def test_each_part_that_differs_is_seen(self):
        for name, part, change in [
            ("position", "position", 0.01), ("colour", "colour", 0.01), ("opacity", "opacity", 0.01), ("harmonics", "harmonics", 0.01),
        ]:
            ours = scene()
            values = ours[name].copy()
            values[3] += change
            apart = formats.differences(ours, ours | {name: values})
            self.assertEqual([p for p, value in apart.items() if value > 1e-9], [part])

    def test_a_larger_gaussian_differs_in_size_and_a_turned_one_in_shape(self):
        ours = scene()
        apart = formats.differences(ours, ours | {"covariance": 1.2 * ours["covariance"]})
        self.assertAlmostEqual(apart["size"], np.log(1.2) / 2)
        self.assertLess(apart["shape"], 1e-9)
        mirrored = ours["covariance"] * [1, -1, 1, 1, -1, 1]
        self.assertGreater(formats.differences(ours, ours | {"covariance": mirrored})["shape"], 0.1)

    def test_another_count_or_degree_is_condemned(self):
        ours = scene()
        with self.assertRaisesRegex(SystemExit, "39"):
            formats.differences(ours, {name: values[1:] for name, values in ours.items()})
        with self.assertRaisesRegex(SystemExit, "8, 3"):
            formats.differences(ours, ours | {"harmonics": ours["harmonics"][:, :8]})

    def test_two_half_turns_are_none_and_one_is_a_difference(self):
        ours = scene()
        self.assertEqual(set(formats.differences(ours, formats.y_up(formats.y_up(ours))).values()), {0.0})
        self.assertGreater(formats.differences(ours, formats.y_up(ours))["position"], 0.1)


if __name__ == "__main__":
    unittest.main()
