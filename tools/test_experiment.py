"""Tests of experiment.py: what is a row and what is not, on a program that only pretends to be fled."""

import contextlib
import io
import json
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import experiment

TOOLS = Path(__file__).parent
# Its scores follow from its options. A file `says.json` beside it holds what it says of the machine and of networks.
PRETENDER = f"""#!{sys.executable} -IS
# build 1
import json, pathlib, sys
said = json.loads(pathlib.Path(__file__).with_name("says.json").read_text())
if sys.argv[1] in ("doctor", "models"):
    print(json.dumps(said[sys.argv[1]]))
    sys.exit(1)
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
(out / "work").mkdir(parents=True, exist_ok=True)
values = dict(word.split("=") for flag, word in zip(sys.argv, sys.argv[1:]) if flag == "--set")
steps = int(values["steps"])
def record(split, image, psnr):
    return dict(split=split, image=image, reference="gt", brightness="final", psnr_cc_db=psnr, ssim=psnr / 100)
psnr = 20 + steps / 100 + int(values["seed"]) / 10
records = [record("held_out", "render", psnr), record("train", "render", psnr + 2), record("held_out", "enhanced", 15)]
rounds = [dict(records=records, sharpness=dict(render=5), gaussians=7, steps_per_second=10)] * int(values["rounds"])
(out / "metrics.json").write_text(json.dumps(dict(rounds=rounds, config=dict(steps=steps))))
(out / "scene.ply").write_text("a scene")
with pathlib.Path(__file__).with_name("runs").open("a") as runs:
    print(json.dumps(sys.argv[1:]), file=runs)
if said["fails"]:
    sys.exit(3)
if said["swaps"]:
    pathlib.Path(__file__).write_text(pathlib.Path(__file__).read_text() + "# build 2\\n")
"""
SAYS = {
    "doctor": {"checks": [{"name": name, "detail": "1"} for name in (*experiment.COMPUTING, "disk")]},
    "models": {"models": [{"id": "small", "sha256": "aa"}, {"id": "unknown", "sha256": None}]},
    "fails": False,
    "swaps": False,
}
EXPERIMENT = {
    "question": "What twice the steps bring",
    "photographs": "as taken",
    "preset": "preview",
    "seeds": 2,
    "set": {"rounds": 2, "steps": 100, "deblur": "small"},
    "variants": [{"name": "{deblur}, {steps}", "set": {}}, {"name": "twice", "set": {"steps": "2x"}}],
}


class Pretended(unittest.TestCase):
    """With a program, an experiment and a capture in a folder of their own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.top = Path(folder.name)
        self.program, self.out = self.top / "fled", self.top / "out"
        self.program.write_text(PRETENDER)
        self.program.chmod(0o755)
        self.capture = self.top / "fox"
        for name in ("images", "gt"):
            (self.capture / name).mkdir(parents=True)
            (self.capture / name / "1.png").write_text(name)
        (self.capture / "poses_bounds.npy").write_text("poses")
        self.say()
        self.write(EXPERIMENT)

    def say(self, **changed):
        (self.top / "says.json").write_text(json.dumps(SAYS | changed))

    def write(self, content):
        (self.top / "experiment.json").write_text(json.dumps(content))

    def table(self, *words, captures=None):
        """What the command prints."""
        command = ["experiment.py", self.top / "experiment.json", "--fled", self.program, "--out", self.out, *words]
        command += captures or [self.capture]
        printed = io.StringIO()
        quiet = contextlib.redirect_stderr(io.StringIO())
        with mock.patch("sys.argv", list(map(str, command))), contextlib.redirect_stdout(printed), quiet:
            experiment.main()
        return printed.getvalue()

    def runs(self):
        """Command lines of the runs since this was last asked."""
        file = self.top / "runs"
        lines = file.read_text().splitlines() if file.exists() else []
        file.unlink(missing_ok=True)
        return [json.loads(line) for line in lines]


class Rows(Pretended):
    def test_a_finished_experiment_is_not_run_again(self):
        first = self.table()
        self.assertEqual(len(self.runs()), 4)
        self.assertEqual((self.table(), self.runs()), (first, []))

    def test_a_run_is_known_by_its_content_wherever_its_capture_lies(self):
        self.table()
        self.runs()
        (self.top / "elsewhere").mkdir()
        self.capture = self.capture.rename(self.top / "elsewhere" / "fox")
        self.table()
        self.assertEqual(self.runs(), [])

    def assert_all_stale(self, *words):
        self.assertNotIn("| fox |", self.table("--finished", *words))
        self.assertEqual(self.runs(), [])
        self.table(*words)
        self.assertEqual(len(self.runs()), 4)

    def test_another_build_of_the_program_makes_every_row_stale(self):
        self.table()
        self.runs()
        self.program.write_text(PRETENDER.replace("build 1", "build 2"))
        self.assert_all_stale()

    def test_another_option_or_preset_makes_every_row_stale(self):
        self.table()
        self.runs()
        self.assert_all_stale("--set", "size=100")
        self.assert_all_stale("--preset", "standard")

    def test_another_photograph_in_the_capture_makes_every_row_stale(self):
        self.table()
        self.runs()
        (self.capture / "images" / "1.png").write_text("brighter")
        self.assert_all_stale()
        (self.capture / "images" / "1.png").rename(self.capture / "images" / "2.png")
        self.assert_all_stale()

    def test_another_network_of_the_same_name_makes_every_row_stale(self):
        self.table()
        self.runs()
        self.say(models={"models": [{"id": "small", "sha256": "bb"}]})
        self.assert_all_stale()

    def test_another_content_of_a_networks_file_makes_every_row_stale(self):
        network = self.top / "own.onnx"
        network.write_text("one")
        self.table("--set", f"deblur={network}")
        self.runs()
        network.write_text("two")
        self.assert_all_stale("--set", f"deblur={network}")

    def test_another_adapter_makes_every_row_stale_and_another_disk_none(self):
        self.table()
        self.runs()
        checks = SAYS["doctor"]["checks"]
        self.say(doctor={"checks": [*checks[:-1], {"name": "disk", "detail": "2"}]})
        self.table()
        self.assertEqual(self.runs(), [])
        self.say(doctor={"checks": [{"name": "adapter", "detail": "2"}, *checks[1:]]})
        self.assert_all_stale()

    def test_another_seed_or_variant_is_run_beside_what_there_is(self):
        self.table()
        self.runs()
        self.table("--seeds", "3")
        self.assertEqual(len(self.runs()), 2)
        changed = EXPERIMENT["variants"] + [{"name": "thrice", "set": {"steps": "3x"}}]
        self.write(EXPERIMENT | {"variants": changed})
        self.table()
        self.assertEqual([run.count("steps=300") for run in self.runs()], [1, 1])


class Records(Pretended):
    def test_a_folder_with_a_scene_is_no_record(self):
        self.say(fails=True)
        with self.assertRaisesRegex(SystemExit, "ended with 3"):
            self.table()
        self.assertEqual(len(list(self.out.glob("runs/*/scene.ply"))), 1)
        self.assertNotIn("| fox |", self.table("--finished"))
        self.say()
        self.assertIn("| fox |", self.table())

    def test_a_run_whose_program_was_replaced_meanwhile_is_no_record(self):
        self.say(swaps=True)
        with self.assertRaisesRegex(SystemExit, "program changed while it ran"):
            self.table()
        self.assertEqual(list(self.out.glob("runs/*.json")), [])

    def test_a_record_of_other_facts_than_its_name_says_is_refused(self):
        self.table()
        record = sorted(self.out.glob("runs/*.json"))[0]
        content = json.loads(record.read_text())
        content["facts"]["preset"] = "paper"
        record.write_text(json.dumps(content))
        with self.assertRaisesRegex(SystemExit, "another run than its name says"):
            self.table()

    def test_poses_are_not_shared_by_builds(self):
        self.table()
        self.program.write_text(PRETENDER.replace("build 1", "build 2"))
        self.table()
        self.assertEqual(len({run[run.index("--cache") + 1] for run in self.runs()}), 2)


class Inputs(Pretended):
    def test_the_later_option_wins_and_the_variants_is_the_last(self):
        self.table("--set", "steps=50", captures=[f"{self.capture}:steps=60;size=9"])
        steps = {word for run in self.runs() for word in run if word.startswith("steps=")}
        self.assertEqual(steps, {"steps=60", "steps=120"})

    def test_twice_of_nothing_is_refused(self):
        self.write(EXPERIMENT | {"set": {"rounds": 1}, "variants": EXPERIMENT["variants"][1:]})
        with self.assertRaisesRegex(SystemExit, "steps=2x: of what"):
            self.table()

    def test_a_network_without_a_checksum_is_refused(self):
        with self.assertRaisesRegex(SystemExit, "deblur=unknown"):
            self.table("--set", "deblur=unknown")

    def test_a_misspelt_key_two_variants_of_a_name_and_an_unknown_one_are_refused(self):
        self.write(EXPERIMENT | {"seed": 1})
        with self.assertRaisesRegex(SystemExit, "seed"):
            self.table()
        self.write(EXPERIMENT | {"variants": EXPERIMENT["variants"][:1] * 2})
        with self.assertRaisesRegex(SystemExit, "one name"):
            self.table()
        self.write(EXPERIMENT)
        with self.assertRaisesRegex(SystemExit, "no such variant: thrice"):
            self.table("--only", "thrice")

    def test_ground_truth_takes_the_place_of_the_photographs_and_nothing_else_comes_along(self):
        self.write(EXPERIMENT | {"photographs": "ground truth"})
        (self.capture / "notes.txt").write_text("not used")
        self.table()
        given = Path(self.runs()[0][1])
        files = {file.relative_to(given).as_posix(): file.read_text() for file in given.rglob("*") if file.is_file()}
        self.assertEqual(files, {"images/1.png": "gt", "gt/1.png": "gt", "poses_bounds.npy": "poses"})
        (self.capture / "notes.txt").write_text("still not used")
        self.table()
        self.assertEqual(self.runs(), [])
        (self.capture / "gt" / "1.png").write_text("another truth")
        self.table()
        self.assertEqual(len(self.runs()), 4)

    def test_the_experiments_that_are_here_can_be_read_and_their_variants_differ(self):
        files = sorted((TOOLS / "experiments").glob("*.json"))
        self.assertEqual([file.stem for file in files], ["networks", "parts", "trainer"])
        for file in files:
            read = experiment.read_experiment(file)
            runs = [experiment.merged(read.options, variant.options) for variant in read.variants]
            alike = [run for number, run in enumerate(runs) if run in runs[:number]]
            self.assertEqual(alike, [], file.name)


class Table(Pretended):
    def test_a_row_has_means_their_spread_and_differences_to_the_first_variant(self):
        question, _, titles, _, photographs, first, twice = self.table().splitlines()
        self.assertEqual(question, EXPERIMENT["question"])
        self.assertEqual(titles.count("|"), twice.count("|"))
        self.assertIn("| fox | (the brightened photographs) | 15.00 ± 0.00 / 0.1500 |", photographs)
        self.assertEqual(first, "| fox | small, 100 | 21.05 ± 0.07 / 0.2105 | - | 2.0 | - | 5 | 7 | 20 | 2 |")
        self.assertEqual(twice, "| fox | twice | 22.05 ± 0.07 / 0.2205 | +1.00 | 2.0 | - | 5 | 7 | 40 | 2 |")

    def test_the_mean_over_captures_counts_each_once(self):
        other = self.top / "hare"
        (other / "images").mkdir(parents=True)
        lines = self.table("--seeds", "1", captures=[self.capture, f"{other}:steps=300"]).splitlines()
        self.assertIn("| mean | twice | 24.00 / 0.2400 | +2.00 |", lines[-1])

    def test_a_run_without_held_out_views_is_an_error(self):
        self.program.write_text(PRETENDER.replace('"held_out", "render"', '"train", "render"'))
        with self.assertRaisesRegex(SystemExit, "no held-out views"):
            self.table()


if __name__ == "__main__":
    unittest.main()
