"""MATLAB's MAT-files, version 5 to 7, as data."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError

_MOST = 16 * 2**20  # bytes, packed or unpacked
_HEADER, _TAG, _PACKED = 128, 8, 15


def read_mat(path: Path) -> dict[str, NDArray[np.generic]]:
    """Variables by name; cells are arrays of arrays.

    Raises
    ------
    DataError : no MAT-file, one of version 7.3, or one that holds more than 16 MiB.
    """
    from scipy.io import loadmat, whosmat

    _check_size(path)
    try:
        kinds = {name: (shape, kind) for name, shape, kind in whosmat(str(path))}
        wanted = [
            name
            for name, (shape, kind) in kinds.items()
            if kind in ("cell", "double", "single") and np.prod(shape, dtype=np.float64) <= _MOST
        ]
        held = loadmat(str(path), variable_names=wanted)
    except NotImplementedError:
        raise DataError(f"{path}: a MAT-file of version 7.3 is not read; save it by save(name, '-v7')") from None
    except Exception as error:  # SciPy raises whatever a malformed file leads it to
        raise DataError(f"{path}: not readable as MAT-file: {type(error).__name__}: {error}") from None
    return {name: np.asarray(held[name]) for name in wanted}


def _check_size(path: Path) -> None:
    """Refuse what would fill the memory when it is unpacked."""
    told = DataError(f"{path}: expected at most {_MOST} bytes of cameras, packed or unpacked")
    if path.stat().st_size > _MOST:
        raise told
    data = path.read_bytes()
    order = "<" if data[126:128] == b"IM" else ">"
    at, left = _HEADER, _MOST
    while at + _TAG <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        at += _TAG
        if kind == _PACKED:
            try:
                left -= len(zlib.decompressobj().decompress(data[at : at + size], left + 1))
            except zlib.error as error:
                raise DataError(f"{path}: not readable as MAT-file: {error}") from None
            if left < 0:
                raise told
        at += size
