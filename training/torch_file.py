"""Where the tensors of a PyTorch file lie in it, so that another file can point at them. Needs no PyTorch.

Such a file is a zip archive without compression: a pickle that says which tensor is which part of which storage, and a
member for each storage, its numbers one after the other, little-endian.
"""

import collections
import pickle
import struct
import zipfile
from math import prod
from typing import NamedTuple

# Of a zip member's local header up to its name, whose length and that of the extra field are its last four bytes.
LOCAL_HEADER = 30


class Place(NamedTuple):
    """Bytes from the file's beginning, bytes, and the shape of the f32 numbers there."""

    offset: int
    length: int
    shape: tuple


class Layout(pickle.Unpickler):
    """Reads which storage each tensor has, and nothing else: a pickle may ask for any code at all."""

    def find_class(self, module, name):
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda storage, first, shape, strides, *_: (storage, first, shape, strides)
        if module == "torch" and name.endswith("Storage"):
            return name
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a file of tensors")

    def persistent_load(self, identity):
        _, kind, key, _, count = identity
        return kind, key, count


def tensors(path):
    """Name -> Place of every f32 tensor; others, such as counters, are left out."""
    places = {}
    with zipfile.ZipFile(path) as archive, path.open("rb") as raw:
        members = {member.filename.partition("/")[2]: member for member in archive.infolist()}
        with archive.open(members["data.pkl"]) as content:
            state = Layout(content).load()
        # Only newer files say so; the others are of little-endian machines.
        if "byteorder" in members and archive.read(members["byteorder"]) != b"little":
            raise SystemExit(f"{path.name} is not little-endian")
        for name, ((kind, key, count), first, shape, strides) in state.items():
            if kind != "FloatStorage":
                continue
            member = members[f"data/{key}"]
            contiguous = tuple(prod(shape[axis + 1 :]) for axis in range(len(shape)))
            if member.compress_type != zipfile.ZIP_STORED or member.file_size != 4 * count:
                raise SystemExit(f"{path.name}: the storage of {name} is compressed or has another size than it says")
            if strides != contiguous or first + prod(shape) > count:
                raise SystemExit(f"{path.name}: the numbers of {name} do not lie one after the other")
            raw.seek(member.header_offset)
            start = member.header_offset + LOCAL_HEADER + sum(struct.unpack("<HH", raw.read(LOCAL_HEADER)[-4:]))
            places[name] = Place(start + 4 * first, 4 * prod(shape), tuple(shape))
    return places
