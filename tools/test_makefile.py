"""Tests of the Makefile: that `make help` lists every command."""

import re
import subprocess
import unittest
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent


def commands(text):
    """The commands declared in a Makefile."""
    declared = re.findall(r"^\.PHONY:(.*)", text.replace("\\\n", " "), re.MULTILINE)
    return " ".join(declared).split()


class Help(unittest.TestCase):
    def test_every_target_is_a_command_and_help_says_what_it_does(self):
        text = (TOP / "Makefile").read_text()
        targets = re.findall(r"^([\w/.-]+):(?!=)", text, re.MULTILINE)
        self.assertEqual(sorted(set(targets) - {".PHONY"}), sorted(commands(text)))
        answer = subprocess.run(["make", "--no-print-directory", "help"], cwd=TOP, check=True, capture_output=True, text=True)
        listed = re.findall(r"^  make (\S+) +\S", answer.stdout, re.MULTILINE)
        self.assertEqual(sorted(listed), sorted(commands(text)))

    def test_commands_are_found_over_lines_that_go_on(self):
        self.assertEqual(commands(".PHONY: a b \\\n    c\nd: e\n"), ["a", "b", "c"])


if __name__ == "__main__":
    unittest.main()
