"""Tests of environment.py: when an environment is rebuilt."""

import subprocess
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import environment


class Environment(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.top = Path(folder.name)
        self.requirements = self.top / "requirements.txt"
        self.requirements.write_text("# why\none==1\n")

    def made(self, code=0):
        """The number of programs started to make the environment."""
        def start(command, **_):
            (self.top / "venv").mkdir(exist_ok=True)
            (self.top / "venv" / "pyvenv.cfg").touch()
            return subprocess.CompletedProcess(command, code if "pip" in command else 0)

        with mock.patch("subprocess.run", side_effect=start) as run, mock.patch("builtins.print"):
            environment.make(self.top / "venv", self.requirements)
        return run.call_count

    def test_an_environment_is_made_once_and_again_when_its_requirements_change(self):
        self.assertEqual([self.made(), self.made()], [2, 0])
        self.requirements.write_text("one==2\n")
        self.assertEqual([self.made(), self.made()], [2, 0])

    def test_requirements_of_another_file_count(self):
        (self.top / "more.txt").write_text("-r requirements.txt\ntwo==2\n")
        self.assertEqual(environment.pinned(self.top / "more.txt"), ["one==1", "two==2"])

    def test_an_environment_whose_installation_failed_is_not_taken(self):
        with self.assertRaisesRegex(SystemExit, "pip failed"):
            self.made(code=1)
        self.assertEqual(self.made(), 2)

    def test_a_folder_that_is_no_environment_is_left_alone(self):
        (self.top / "venv").mkdir()
        (self.top / "venv" / "letter.txt").touch()
        with self.assertRaisesRegex(SystemExit, "no Python environment"):
            self.made()
        self.assertTrue((self.top / "venv" / "letter.txt").exists())


if __name__ == "__main__":
    unittest.main()
