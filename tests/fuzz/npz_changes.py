"""Changes to the arrays of an npz file, and to the headers they have."""

from __future__ import annotations

import io
import struct
import zipfile
from random import Random
from typing import Any

import numpy as np

from .bytes_changes import changed_bytes
from .zip_changes import changed_zip, entries_of, zip_bytes

_HEADERS = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '<f8', 'fortran_order': True, 'shape': (%s, %s), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '|V%s', 'fortran_order': False, 'shape': (2,), }",
    "{'descr': '<U%s', 'fortran_order': False, 'shape': (2,), }",
    "{'descr': [('a', '<f8'), ('b', '|O')], 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (), }",
    "{'descr': '>f8', 'fortran_order': 0, 'shape': [%s], }",
    "{'descr': '<f8', 'shape': (%s,)}",
    "{'descr': '<M8[%s]', 'fortran_order': False, 'shape': (1,), }",
    "__import__('os').system('touch /tmp/tokt-fuzz-evil')",
    "[" * 900 + "%s",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), } # \0",
    "(" + "-" * 3000 + "1,)",
)
_COUNTS = ("0", "1", "-1", "2", "100", str(2**31), str(2**40), str(2**62), str(2**64), "1" * 4500)
_COUNTS += ("1.5", "None", "'a'", "True", "10**9", "1e3", "(1,)")
_VALUES = (0.0, -0.0, 1e-320, 1e308, -1e308, float("nan"), float("inf"), -float("inf"), 1.0)


def npy_bytes(array: Any) -> bytes:
    """The array as numpy writes it, pickled where it holds objects."""
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array))
    return out.getvalue()


def _with_header(data: bytes, rng: Random) -> bytes:
    """Another header before the same numbers."""
    text = rng.choice(_HEADERS)
    text = text % tuple(rng.choice(_COUNTS) for _ in range(text.count("%s")))
    header = (text + "\n").encode("latin-1")
    version = rng.choice(((1, 0), (1, 0), (2, 0), (3, 0), (9, 9)))
    length = rng.choice((len(header), len(header), len(header), 0, 0xFFFF, 10))
    packed = struct.pack("<H" if version == (1, 0) else "<L", length & 0xFFFF)
    return b"\x93NUMPY" + bytes(version) + packed + header + data[-64:]


def _with_values(data: bytes, rng: Random) -> bytes:
    """Other numbers, another shape or another type."""
    array = np.lib.format.read_array(io.BytesIO(data))
    kind = rng.randrange(6)
    if kind == 0:
        types = ("<f4", ">f8", "<i8", "|b1", "|u1", "<u8", "<c16", "O", "<U3", "<M8[s]", "<f8")
        with np.errstate(all="ignore"):
            return npy_bytes(array.astype(rng.choice(types)))
    if kind == 1:
        shapes = ((-1,), (1, -1), (-1, 1), (1, 1, -1), (-1, 1, 1, 1))
        return npy_bytes(array.reshape(rng.choice(shapes)))
    if kind == 2:
        return npy_bytes(array[:0] if array.ndim and rng.random() < 0.5 else array.ravel()[:-1])
    if kind == 3:
        return npy_bytes(np.concatenate([array, array]) if array.ndim else array)
    if kind == 4:
        return npy_bytes(np.asfortranarray(np.broadcast_to(array, (2, *array.shape)).copy()))
    flat = array.ravel().copy()
    if flat.size:
        at = rng.randrange(flat.size)
        if flat.dtype.kind == "f":
            flat[at] = rng.choice((*_VALUES, flat[at] * 1.0000001, -flat[at]))
        elif flat.dtype.kind in "iu":
            most = int(np.iinfo(flat.dtype).max)
            flat[at] = rng.choice((0, 1, most, most // 2, int(flat[at]) ^ 1))
        else:
            flat[at] = not flat[at]
    return npy_bytes(flat.reshape(array.shape))


def changed_npz(data: bytes, rng: Random) -> bytes:
    """An npz file of whose arrays one or two are not what they were."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        sound = {name: archive.read(name) for name in archive.namelist()}
    arrays = dict(sound)
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(list(sound))
        kind = rng.randrange(12)
        if kind < 4:
            arrays[name] = _with_header(sound[name], rng)
        elif kind < 8:
            arrays[name] = _with_values(sound[name], rng)
        elif kind == 8:
            arrays[name] = changed_bytes(sound[name], rng, list(sound.values()))
        elif kind == 9 and len(arrays) > 1:
            arrays.pop(name, None)
        elif kind == 10:
            arrays[rng.choice(("more.npy", "../evil.npy", "weights", ""))] = sound[name]
        else:
            return changed_zip(arrays, rng)
    return zip_bytes(entries_of(arrays))
