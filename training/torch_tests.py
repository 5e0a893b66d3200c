"""What of the recipe needs PyTorch, its photographs or a C compiler: make test-training"""

import itertools
import json
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import numpy as np
import onnxruntime
import torch

import dataset
import degrade
import evaluate
import export
import matcher
import matcher_check
import matcher_reference
import self_test
import sources
import speed
import train
from depthwise import Depthwise, depthwise, library
from muon import SIZE, Muon, matrices, orthogonal
from network import Network, grown, logarithmic_loss


class Guides(unittest.TestCase):
    def test_guides_made_by_the_trainer_are_those_of_the_patches(self):
        view, render = (np.random.default_rng(4).random((2, 16, 24, 3), np.float32) * 0.06 + 0.3)
        planes = [torch.from_numpy(image).movedim(2, 0)[None] for image in (view, render)]
        ours = train.trusted(*planes)[0].movedim(0, 2).numpy()
        np.testing.assert_allclose(ours, degrade.trusted(view, render), atol=1e-6)

    def test_real_renders_are_part_of_the_stream_where_there_are_any(self):
        with tempfile.TemporaryDirectory() as folder:
            # A flat view, which no other scene is, with a striped and brighter render.
            planes = np.repeat(np.array([0.3, 0.32, 0.3], np.float16), 3)[:, None, None] + np.zeros((9, 180, 320), np.float16)
            planes[3:6, ::2] += 0.02
            np.save(Path(folder) / "1000-000.render.npy", planes)
            drawn = [pair for pair, _ in itertools.islice(dataset.Patches(3, 0, folder), 400)]
            guides = [pair[3:] for pair in drawn if float(pair[0].std()) < 1e-3]
            guided = [guide for guide in guides if float(guide.std()) > 1e-3]
            self.assertTrue(20 < len(guided) < len(guides) < 300, (len(guided), len(guides)))
            for guide in guides:
                places = [place for rows in guide.chunk(2, 1) for place in rows.chunk(2, 2)]
                striped = {float(place.std()) > 1e-3 for place in places}
                self.assertEqual((tuple(guide.shape), len(striped)), ((3, dataset.PATCH, dataset.PATCH), 1), "a whole patch has a guide or none of it")
            self.assertAlmostEqual(float(torch.stack(guided).mean()), 0.3, delta=1e-3, msg="only detail comes from a render")
        with self.assertRaises(FileNotFoundError):
            dataset.Patches(3, 0, "/nowhere")


class OwnGuides(unittest.TestCase):
    def test_only_what_has_no_guide_is_given_one_of_the_networks_own(self):
        view = torch.rand(6, 3, 16, 16) * 0.1 + 0.4
        pair = torch.cat([view, view], 1)
        pair[3:, 3:] += 0.05

        def striped(pair):
            return pair[:, :3] + 0.04 * (torch.arange(16) % 2 - 0.5)

        for share, expected in ((0.0, 0), (1.0, 3)):
            given = train.with_own_guides(pair, striped, share)
            changed = (given != pair).flatten(1).any(1)
            self.assertEqual(changed.tolist(), [True] * expected + [False] * (6 - expected))
            self.assertTrue((given[:, :3] == pair[:, :3]).all())
        torch.testing.assert_close(given[:3, 3:], striped(pair[:3]), atol=1e-3, rtol=0)


class Loss(unittest.TestCase):
    def test_a_tenth_off_any_samples_error_counts_the_same(self):
        clean = torch.zeros(2, 3, 16, 16)
        noisy, nearly = torch.full((1, 3, 16, 16), 0.3), torch.full((1, 3, 16, 16), 0.06)

        def loss(first, second):
            return float(logarithmic_loss(torch.cat([first * noisy, second * nearly]), clean, 0.1))

        whole = loss(1, 1)
        self.assertAlmostEqual(whole - loss(0.9, 1), whole - loss(1, 0.9), delta=0.01)
        self.assertGreater(whole - loss(0.9, 1), 0.05)


class Data(unittest.TestCase):
    def test_held_out_photographs_are_never_trained_on(self):
        held_out = sources.HELD_OUT + sources.HELD_OUT_LANDSCAPES
        self.assertFalse({path.name for path in sources.TRAINING} & {path.name for path in held_out})

    def test_one_seed_gives_one_stream(self):
        first, second = (next(iter(dataset.Patches(3))) for _ in range(2))
        torch.testing.assert_close(first, second)
        self.assertEqual(tuple(first[0].shape), (6, dataset.PATCH, dataset.PATCH))


class Depth(unittest.TestCase):
    def test_the_fast_backward_pass_is_pytorchs(self):
        self.assertIsNotNone(library())
        torch.manual_seed(1)
        for channels, height, width, taps in ((16, 9, 12, 3), (32, 8, 8, 5), (16, 20, 7, 7), (48, 4, 11, 9)):
            x = torch.randn(2, channels, height, width, requires_grad=True)
            layer = torch.nn.Conv2d(channels, channels, taps, padding=taps // 2, groups=channels)
            wanted = torch.randn_like(x)
            inputs = (x, layer.weight, layer.bias)
            expected = torch.autograd.grad((layer(x) * wanted).sum(), inputs)
            found = torch.autograd.grad((Depthwise.apply(*inputs) * wanted).sum(), inputs)
            torch.testing.assert_close(found, expected, atol=1e-3, rtol=1e-4)

    def test_a_size_without_code_is_an_error(self):
        x = torch.randn(1, 8, 4, 4, requires_grad=True)
        with self.assertRaises(ValueError):
            Depthwise.apply(x, torch.randn(8, 1, 7, 7), torch.randn(8)).sum().backward()

    def test_training_uses_it_and_in_bf16_it_is_nearly_as_exact(self):
        torch.manual_seed(2)
        x = torch.randn(2, 16, 12, 12, requires_grad=True)
        layer = torch.nn.Conv2d(16, 16, 7, padding=3, groups=16)
        (expected,) = torch.autograd.grad(layer(x).square().sum(), (layer.weight,))
        with torch.autocast("cpu", torch.bfloat16):
            output = depthwise(layer, x)
        self.assertIn("Depthwise", output.grad_fn.name())
        (found,) = torch.autograd.grad(output.float().square().sum(), (layer.weight,))
        self.assertLess(float((found - expected).norm() / expected.norm()), 0.01)
        with torch.no_grad():
            self.assertIsNone(depthwise(layer, x).grad_fn)


class Optimiser(unittest.TestCase):
    def test_every_weight_is_a_matrix_or_not(self):
        network = Network(width=4)
        dense, rest = matrices(network)
        self.assertEqual({id(w) for w in dense} | {id(w) for w in rest}, {id(w) for w in network.parameters()})
        self.assertEqual(len(dense) + len(rest), len(list(network.parameters())))
        block = network.encoders[0][0]
        for weight, there in ((block.a1.weight, dense), (network.stem.weight, dense), (block.a2.weight, rest), (block.a1.bias, rest)):
            self.assertTrue(any(weight is other for other in there))

    def test_an_update_is_orthogonal_and_as_large_as_adams(self):
        torch.manual_seed(0)
        rows, _, columns = torch.linalg.svd(torch.randn(2, 8, 24), full_matrices=False)
        stretched = rows @ (torch.logspace(-1, 1, 8)[:, None] * columns)
        values = torch.linalg.svdvals(orthogonal(stretched))
        self.assertTrue(bool(((values > 0.6) & (values < 1.3)).all()), values)
        self.assertGreater(float((orthogonal(stretched) * (rows @ columns)).sum()) / (2 * 8), 0.8)
        for shape in ((8, 24, 1, 1), (24, 2, 2, 2)):
            weight = torch.nn.Parameter(torch.zeros(shape))
            weight.grad = torch.randn(shape)
            Muon([weight], lr=1e-3).step()
            self.assertLess(abs(float(weight.detach().square().mean().sqrt()) / (1e-3 * SIZE) - 1), 0.3)
            self.assertLess(float((weight.detach() * weight.grad).sum()), 0)

    def test_training_that_was_interrupted_goes_on_with_its_momenta(self):
        pair, clean = torch.rand(2, 6, 32, 32), torch.rand(2, 3, 32, 32)
        with tempfile.TemporaryDirectory() as folder:
            arguments = ["train.py", "--width", "4", "--muon", "--run", folder, "--exact"]
            with mock.patch("sys.argv", arguments):
                options = train.arguments()
            whole = train.Trainer(options)
            # Past the warm-up, so that a step is a step.
            whole.step, whole.seconds = 300, 30 * options.minutes
            whole.update(pair, clean)
            whole.save()
            again = train.Trainer(options)
            self.assertEqual(again.step, 301)
            for first, second in zip(whole.optimisers, again.optimisers):
                torch.testing.assert_close(second.state_dict()["state"], first.state_dict()["state"], rtol=0, atol=0)
            momentum = whole.optimisers[1].state[whole.network.stem.weight]["momentum"]
            self.assertGreater(float(momentum.abs().max()), 0)
            # Guides of its own are drawn at random.
            for trainer in (whole, again):
                torch.manual_seed(1)
                trainer.update(pair, clean)
            torch.testing.assert_close(again.network.state_dict(), whole.network.state_dict(), rtol=0, atol=0)
            options.muon = False
            with self.assertRaises(SystemExit):
                train.Trainer(options)


class Growth(unittest.TestCase):
    def test_a_grown_network_does_what_it_did(self):
        torch.manual_seed(0)
        small = Network(encoder=(1, 1, 1), middle=1, decoder=(1, 1, 1), taps=(3, 3, 3, 3))
        large = Network()
        large.load_state_dict(grown(large, small.state_dict()))
        pair = torch.rand(1, 6, 48, 48)
        with torch.no_grad():
            torch.testing.assert_close(large(pair), small(pair), atol=1e-5, rtol=0)
            # Of a network without a gist, as all were once.
            for block in itertools.chain(*small.decoders):
                block.condition.weight.zero_()
            old = {name: value for name, value in small.state_dict().items() if "gist" not in name and "condition" not in name}
            large.load_state_dict(grown(large, old))
            torch.testing.assert_close(large(pair), small(pair), atol=1e-5, rtol=0)

    def test_what_does_not_fit_is_an_error(self):
        with self.assertRaises(ValueError):
            grown(Network(width=32), Network().state_dict())
        with self.assertRaises(ValueError):
            grown(Network(), Network(width=32).state_dict())
        with self.assertRaises(ValueError):
            grown(Network(encoder=(1, 1, 1)), Network().state_dict())


class Evaluation(unittest.TestCase):
    def test_the_gates_read_the_columns_that_they_name(self):
        # Input, guide alone, single, guided: a number of its own in every cell; SSIM is not what is asked for.
        cells = np.arange(len(evaluate.CASES) * 4).reshape(-1, 4, 1) * [1.0, 0.0]
        # And of a second network, which gains one more.
        cells = np.concatenate([cells, cells[:, 2:] + [1.0, 0.0]], 1)
        rows = [(case["name"], *row) for case, row in zip(evaluate.CASES, cells)]
        there = [value[2:] for value in evaluate.gates(rows)]
        self.assertEqual(there, [(2.0, 3.0)] * 4)
        rows[0][3][0] = 40.5
        self.assertEqual(evaluate.gates(rows)[0][1:], (40.0, 40.5, 3.0))

    def test_scores_are_those_of_the_published_definitions(self):
        image = np.random.default_rng(6).random((32, 24, 3), np.float32)
        self.assertEqual(evaluate.scores(image, image), (100.0, 1.0))
        psnr, ssim = evaluate.scores(np.clip(image * 0.5, 0, 1), image)
        self.assertAlmostEqual(psnr, -10 * np.log10(float(np.mean((image / 2) ** 2))), places=4)
        # Of independent pixels mean and deviation are halved: 4 / 5 for either.
        self.assertAlmostEqual(ssim, 0.64, delta=0.02)


class Export(unittest.TestCase):
    def test_onnx_equals_pytorch(self):
        torch.manual_seed(0)
        network = Network().eval()
        self.assertLess(export.largest_difference(export.build(network), network), export.TOLERANCE)

    def test_training_can_go_on_from_an_exported_file(self):
        network, other = Network().eval(), Network().eval()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.onnx"
            path.write_bytes(export.build(network).SerializeToString())
            other.load_state_dict(export.weights(path))
        pair = torch.rand(1, 6, 32, 32)
        with torch.no_grad():
            torch.testing.assert_close(other(pair), network(pair))

    def test_the_network_that_speed_is_measured_beside_runs(self):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "nafnet.onnx"
            speed.nafnet(path, width=4, encoder=(1, 1), middle=1, decoder=(1, 1))
            session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
            (output,) = session.run(None, {"input": np.zeros((1, 3, 16, 24), np.float32)})
        self.assertEqual(output.shape, (1, 3, 16, 24))

    def test_the_comparison_notices_a_changed_weight(self):
        network = Network().eval()
        model = export.build(network)
        with torch.no_grad():
            network.ending.bias += 1e-3
        self.assertGreater(export.largest_difference(model, network), export.TOLERANCE)

    def test_the_golden_output_is_one_picture_in_three_channels_of_floats(self):
        self.assertEqual(len(export.golden(Network().eval())), 4 * 3 * self_test.SIDE**2)


class Matcher(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.weights = matcher_check.TOP / ".matcher"
        cls.graphs = [matcher_check.session(name, cls.weights) for name in ("xfeat.onnx", "lighterglue.onnx")]
        cls.xfeat, cls.glue = matcher_check.published()
        values = matcher_reference.picture((171, 141), (40, 7))
        cls.image = values.astype(np.float32) / np.float32(255)

    def test_the_graphs_are_those_of_the_recipe_and_hold_no_weights(self):
        for name, model in matcher.graphs(self.weights).items():
            content = (matcher_check.TOP / "models" / name).read_bytes()
            self.assertEqual(model.SerializeToString(), content)
            self.assertLess(len(content), 100_000)

    def test_the_described_steps_give_the_published_points(self):
        found = matcher_reference.described(self.graphs[0], self.image)
        for ours, theirs in zip(found, matcher_reference.published_points(self.xfeat, self.image)):
            matcher_reference.near(ours, theirs, "points")

    def test_what_is_not_published_is_refused(self):
        theirs = matcher_reference.published_points(self.xfeat, self.image)[2]
        ours = matcher_reference.described(self.graphs[0], np.roll(self.image, 1, axis=1))[2]
        for found in (ours, theirs[:-1], theirs + np.nan):
            with self.assertRaisesRegex(SystemExit, "descriptors"):
                matcher_reference.near(found, theirs, "descriptors")

    def test_the_reference_is_what_its_script_makes(self):
        reference = json.loads((matcher_check.TOP / "src" / "core" / "matching" / "reference.json").read_text())
        pair = []
        for entry, expected in zip(matcher_reference.PICTURES, reference["pictures"], strict=True):
            part, listing = matcher_reference.features(self.xfeat, self.graphs[0], entry)
            pair.append(part)
            self.assertEqual(listing["checksum"], expected["checksum"])
            np.testing.assert_allclose(listing["points"], expected["points"], atol=1e-4)
        found = matcher_reference.matches(self.xfeat, self.graphs[1], self.glue, pair)
        np.testing.assert_allclose(found["matches"], reference["matches"], atol=1e-3)

    def test_the_comparison_notices_another_output(self):
        truth = np.zeros((2, 2))
        with mock.patch("builtins.print"):
            verdicts = [matcher_check.row("a", truth + off, truth, truth, 1e-4) for off in (1e-5, 2e-4, np.nan)]
        self.assertEqual(verdicts, [True, False, False])

    def test_one_point_and_many_are_matched(self):
        random = np.random.default_rng(5)
        for counts in ((1, 1), (1, 300), (257, 3)):
            feed = {}
            for side, count in zip("ab", counts):
                feed[f"points_{side}"] = random.random((1, count, 2), np.float32)
                feed[f"descriptors_{side}"] = random.random((1, count, 64), np.float32) / 5
            (scores,) = self.graphs[1].run(None, feed)
            self.assertEqual(scores.shape, counts)
            self.assertTrue(np.isfinite(scores).all() and (scores >= 0).all() and (scores <= 1).all())


if __name__ == "__main__":
    unittest.main()
