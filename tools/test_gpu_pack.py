"""Tests of gpu_pack.py: how it finds the tests in cargo's output."""

import json
import unittest

from gpu_pack import test_executables as executables


def artifact(name, kind, test, executable):
    return json.dumps({
        "reason": "compiler-artifact",
        "target": {"name": name, "kind": [kind]},
        "profile": {"test": test},
        "executable": executable,
    })


LINES = [
    "warning: words of the compiler",
    json.dumps({"reason": "build-finished", "success": True}),
    artifact("fled_core", "lib", False, None),
    artifact("fled_core", "bench", True, "/bench"),
    artifact("fled_core", "lib", True, "/core"),
    artifact("fled_gpu", "lib", True, "/gpu"),
    artifact("other", "lib", True, "/other"),
]


class TestExecutables(unittest.TestCase):
    def test_the_unit_tests_of_the_crates_are_found_among_all_products(self):
        found = executables(LINES, ("fled-core", "fled-gpu"))
        self.assertEqual({crate: str(path) for crate, path in found.items()}, {"fled-core": "/core", "fled-gpu": "/gpu"})

    def test_a_crate_without_tests_is_an_error(self):
        with self.assertRaisesRegex(SystemExit, "fled-server"):
            executables(LINES, ("fled-core", "fled-server"))


if __name__ == "__main__":
    unittest.main()
