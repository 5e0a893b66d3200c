"""Tests of torch_file.py on files made here: needs no PyTorch."""

import collections
import io
import pickle
import sys
import tempfile
import types
import unittest
import zipfile
from pathlib import Path
from unittest import mock

import numpy as np

import torch_file

STORAGES = {"0": np.arange(24, dtype="<f4"), "1": np.array([7], "<i8")}


class Tensor:
    """Pickled as PyTorch does it."""

    def __init__(self, key, kind, first, shape, strides):
        self.storage, self.rest = ("storage", kind, key, "cpu", STORAGES[key].size), (first, shape, strides)

    def __reduce__(self):
        return sys.modules["torch._utils"]._rebuild_tensor_v2, (Storage(self.storage), *self.rest, False, None)


class Storage:
    def __init__(self, identity):
        self.identity = identity


class Pickler(pickle.Pickler):
    def persistent_id(self, thing):
        return thing.identity if isinstance(thing, Storage) else None


def stand_in():
    """Modules with the names that a pickle of tensors has in it."""
    modules = {"torch": types.ModuleType("torch"), "torch._utils": types.ModuleType("torch._utils")}
    for name in ("FloatStorage", "LongStorage"):
        setattr(modules["torch"], name, type(name, (), {"__module__": "torch"}))

    def _rebuild_tensor_v2():
        pass

    _rebuild_tensor_v2.__module__ = "torch._utils"
    _rebuild_tensor_v2.__qualname__ = "_rebuild_tensor_v2"
    modules["torch._utils"]._rebuild_tensor_v2 = _rebuild_tensor_v2
    return modules


class Places(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = Path(folder.name) / "weights.pt"

    def places(self, first=0, shape=(2, 3), strides=(3, 1), compression=zipfile.ZIP_STORED, more=None):
        """Of a file with a tensor `a`, a counter and what else is asked for."""
        content = io.BytesIO()
        with mock.patch.dict(sys.modules, stand_in()):
            kinds = sys.modules["torch"]
            tensors = {"a": Tensor("0", kinds.FloatStorage, first, shape, strides), **(more or {})}
            tensors["counter"] = Tensor("1", kinds.LongStorage, 0, (), ())
            Pickler(content, 2).dump(collections.OrderedDict(tensors))
        with zipfile.ZipFile(self.path, "w", compression) as archive:
            archive.writestr("archive/data.pkl", content.getvalue())
            for key, numbers in STORAGES.items():
                archive.writestr(f"archive/data/{key}", numbers.tobytes())
        return torch_file.tensors(self.path)

    def test_the_numbers_of_a_tensor_lie_where_its_place_says(self):
        places = self.places(first=6)
        self.assertEqual(list(places), ["a"])
        place = places["a"]
        found = np.frombuffer(self.path.read_bytes(), "<f4", place.length // 4, place.offset).reshape(place.shape)
        np.testing.assert_array_equal(found, [[6, 7, 8], [9, 10, 11]])

    def test_what_does_not_lie_in_one_piece_is_refused(self):
        for change in ({"strides": (1, 2)}, {"first": 20}, {"compression": zipfile.ZIP_DEFLATED}):
            with self.assertRaisesRegex(SystemExit, r"weights\.pt: the (storage|numbers) of a "):
                self.places(**change)

    def test_a_file_that_asks_for_code_is_refused(self):
        with self.assertRaisesRegex(pickle.UnpicklingError, r"print is no part"):
            self.places(more={"b": print})


if __name__ == "__main__":
    unittest.main()
