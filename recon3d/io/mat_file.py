"""MATLAB's MAT-files of version 5 to 7, as data: arrays of numbers, and cells of such.

SciPy's reader takes what a file says for granted, and a malformed one ends the process; so every size is checked here
against the bytes that are there, before anything is made of it.

References
----------
The MathWorks, "MAT-File Format", chapter "Level 5 MAT-File Format".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError

_MOST = 16 * 2**20  # bytes, packed or unpacked
_HEADER, _TAG = 128, 8
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_MATRIX, _PACKED = 14, 15
_CELL, _NUMBERS = 1, range(6, 16)  # classes of arrays
_COMPLEX = 0x0800


class _Element(NamedTuple):
    """A part of a file."""

    kind: int
    data: bytes


def read_mat(path: Path) -> dict[str, NDArray[np.generic]]:
    """Arrays of real numbers by name, and cells as arrays of arrays; variables of other classes are passed over.

    Raises
    ------
    DataError : no MAT-file of these versions, malformed, or one that holds more than 16 MiB.
    """
    if path.stat().st_size > _MOST:
        raise DataError(f"{path}: expected at most {_MOST} bytes of cameras, got {path.stat().st_size}")
    data = path.read_bytes()
    mark = data[126:128]
    if data[:10] == b"MATLAB 7.3" or data[1:4] == b"HDF":
        raise DataError(f"{path}: a MAT-file of version 7.3 is not read; save it by save(name, '-v7')")
    if mark not in (b"IM", b"MI"):
        raise DataError(f"{path}: expected a MAT-file of version 5 to 7")
    order = "<" if mark == b"IM" else ">"
    found, left = {}, _MOST
    try:
        for element in _elements(data[_HEADER:], order):
            inner = element
            if element.kind == _PACKED:
                unpacked = zlib.decompressobj().decompress(element.data, left + 1)
                left -= len(unpacked)
                if left < 0:
                    raise DataError(f"{path}: expected at most {_MOST} bytes of cameras, it unpacks to more")
                inner = next(_elements(unpacked, order), element)
            if inner.kind == _MATRIX:
                name, array = _array(inner.data, order)
                if array is not None:
                    found[name] = array
    except (zlib.error, struct.error, ValueError) as error:
        raise DataError(f"{path}: not readable as MAT-file: {error}") from None
    return found


def _elements(data: bytes, order: str) -> Iterator[_Element]:
    """Parts that follow one another."""
    at = 0
    while at + _TAG <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start = at + _TAG
        if kind >> 16:  # up to four bytes, within the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            at += _TAG
        else:
            at = start + size + (0 if kind == _PACKED else -size % 8)
        if start + size > len(data):
            raise ValueError(f"a part of {size} bytes where {len(data) - start} are left")
        yield _Element(kind, data[start : start + size])


def _array(data: bytes, order: str, *, within: bool = False) -> tuple[str, NDArray[np.generic] | None]:
    """Name and content of an array; None of other classes, and of cells within cells."""
    parts = _elements(data, order)
    flags, dimensions, name = (next(parts, _Element(0, b"")) for _ in range(3))
    kind = struct.unpack_from(f"{order}I", flags.data)[0]
    shape = tuple(np.frombuffer(dimensions.data, f"{order}i4").tolist())
    called = name.data.decode("ascii", "replace")
    content = list(parts) if kind & 0xFF == _CELL or kind & 0xFF in _NUMBERS else []
    count = int(np.prod(np.array(shape, object))) if shape else 0
    if not content or min(shape, default=0) < 0 or kind & _COMPLEX:
        return called, None
    if kind & 0xFF != _CELL:
        numbers = np.frombuffer(content[0].data, order + _TYPES[content[0].kind]) if content[0].kind in _TYPES else None
        if numbers is None or numbers.size != count:
            raise ValueError(f"{called or 'a cell'} of shape {shape} holds other numbers than these")
        return called, numbers.reshape(shape, order="F")
    if within or len(content) != count:
        return called, None
    cells = np.empty(count, object)
    for n, cell in enumerate(content):
        cells[n] = _array(cell.data, order, within=True)[1] if cell.kind == _MATRIX else None
    return called, cells.reshape(shape, order="F")
