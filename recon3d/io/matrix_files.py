"""Projection matrices in files of text, NumPy's or MATLAB's."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.mat_file import read_mat
from recon3d.io.parsing import number_fields, read_text
from recon3d.io.photographs import natural
from recon3d.scene.mask_files import IMAGE_SUFFIXES

_TEXT = frozenset({".txt", ".p", ".dat", ".csv", ".proj", ".projection"})
SUFFIXES = _TEXT | {".npy", ".mat"}
"""In lower case."""
MOST = 16 * 2**20
"""Bytes of a file."""

_COUNTS = (4, 12, 16)  # numbers of a line
_NAMED = re.compile(
    rf"(\S.*?(?:{'|'.join(map(re.escape, sorted(IMAGE_SUFFIXES)))}))(?:[\s,;:]+(.*)|)", re.IGNORECASE | re.DOTALL
)


class Matrix(NamedTuple):
    """A projection matrix and where it stands."""

    where: str
    name: str
    """Of the photograph; empty where the file does not say."""
    P: NDArray[np.float64]
    """(3, 4)."""


def matrices_in(file: Path) -> Iterator[Matrix]:
    """Matrices of a file, one after another.

    Raises
    ------
    DataError : when a malformed one is met; names its place.
    """
    suffix = file.suffix.lower()
    if suffix in _TEXT:
        yield from _of_text(file)
        return
    if suffix == ".npy":
        try:
            arrays = {"": np.load(file, mmap_mode="r", allow_pickle=False)}
        except Exception as error:  # NumPy raises whatever a malformed header leads it to
            raise DataError(f"{file}: not readable as NPY: {error}") from None
    else:
        arrays = read_mat(file)
    by_name = {name: found for name in sorted(arrays, key=natural) if (found := _of_array(arrays[name]))}
    several = {name: found for name, found in by_name.items() if len(found) > 1}
    if len(several) > 1:
        raise DataError(f"{file}: expected one array of projection matrices, found {', '.join(several)}")
    for name, found in (several or by_name).items():
        for n, P in enumerate(found):
            where = f"{file}: {name or 'array'}{f'[{n}]' if len(found) > 1 else ''}"
            yield Matrix(where, "", _checked(P, where))


def _of_array(array: NDArray[np.generic]) -> list[NDArray[np.generic]]:
    """The matrices in an array (n, 3, 4), (3, 4, n), (n, 12), (3 n, 4) or of arrays; empty where it holds none."""
    if array.dtype == object:
        cells: list[Any] = list(array.ravel(order="F"))
        return cells if all(cell is not None and cell.shape in ((3, 4), (4, 4)) for cell in cells) else []
    if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
        return []
    if array.shape in ((3, 4), (4, 4)):
        return [array]
    if array.ndim == 3 and array.shape[1:] in ((3, 4), (4, 4)):
        return list(array)
    if array.ndim == 3 and array.shape[:2] in ((3, 4), (4, 4)):
        return list(np.moveaxis(array, 2, 0))
    if array.ndim == 2 and array.shape[1] == 12:
        return list(array.reshape(-1, 3, 4))
    if array.ndim == 2 and array.shape[1] == 4 and array.shape[0] % 3 == 0:
        return list(array.reshape(-1, 3, 4))
    return []


def _of_text(file: Path) -> Iterator[Matrix]:
    name, begun = "", str(file)
    rows: list[NDArray[np.float64]] = []
    for number, line in enumerate(read_text(file, MOST).splitlines(), start=1):
        plain, where = re.sub(r"(#|%|//).*", "", line).strip(), f"{file}:{number}"
        if named := _NAMED.fullmatch(plain):
            name, plain = named[1], named[2] or ""
        words = number_fields(plain, _COUNTS)
        if not words or plain.upper() == "CONTOUR":
            continue
        if len(words) == 1 and not rows and words[0].isdecimal():
            continue  # how many there are
        if len(words) not in _COUNTS:
            raise DataError(f"{where}: expected 4, 12 or 16 numbers, got {line.strip():.80}")
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            raise DataError(f"{where}: expected numbers, got {line.strip():.80}") from None
        if len(words) > 4:
            yield Matrix(where, name, _checked(values.reshape(-1, 4), where))
            name = ""
            continue
        if not rows and (values == [0, 0, 0, 1]).all():
            continue  # the last row of a 4x4
        begun = begun if rows else where
        rows.append(values)
        if len(rows) == 3:
            yield Matrix(begun, name, _checked(np.array(rows), begun))
            name, rows = "", []
    if rows:
        raise DataError(f"{begun}: expected three rows of a projection matrix, got {len(rows)}")


def _checked(P: NDArray[np.generic], where: str) -> NDArray[np.float64]:
    """(3, 4) finite numbers."""
    matrix = np.asarray(P, np.float64)
    if not np.isfinite(matrix).all() or not np.abs(matrix).max() < 1e100:
        raise DataError(f"{where}: expected a projection matrix of finite numbers, got {matrix.tolist()!r:.200}")
    if len(matrix) == 4 and np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9 * max(abs(matrix[3, 3]), 1):
        raise DataError(f"{where}: expected the last row 0 0 0 1 of a 4x4 matrix, got {matrix[3]}")
    return matrix[:3]
