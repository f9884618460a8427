"""Lines of a ``*_par.txt``: a photograph's name and the numbers of its camera, as programs and people write them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.handedness import right_handed, signed
from recon3d.io.parsing import number_fields, read_text
from recon3d.scene.camera import Camera
from recon3d.scene.mask_files import IMAGE_SUFFIXES

_KRT, _P, _P_SQUARE, _K_POSE = 21, 12, 16, 25
_COUNTS = (_KRT, _P, _P_SQUARE, _K_POSE)
_EXPECTED = "expected an image name and 21 numbers (K, R, t), or the 12 of P = K [R | t]"
_ROTATION = 1e-3
"""Largest element of R R^T - I by which numbers are told to be a rotation."""

_QUOTED = re.compile(r"""(["'])(.+?)\1(.*)""")
_WITH_ENDING = re.compile(
    rf"(.*?\.(?:{'|'.join(suffix[1:] for suffix in sorted(IMAGE_SUFFIXES))}))((?:[\s,;].*)?)", re.IGNORECASE
)
_FIRST_FIELD = re.compile(r"([^\s,;]+)(.*)")


class ParLine(NamedTuple):
    """One view of a par file."""

    where: str
    """File and line, for errors."""
    name: str
    """Of the photograph, with / between folders and without ./ before it."""
    numbers: NDArray[np.float64]
    """(21,) K, R, t, row by row; (12,) or (16,) P; or (25,) K and a 4x4 pose."""


def read_par_file(file: Path) -> list[ParLine]:
    """The views of a par file, with or without its count line, comments and a line of headings.

    Raises
    ------
    DataError : a line is malformed, no view is there, or not as many as the count line says; names file and line.
    """
    text = enumerate(read_text(file).splitlines(), start=1)
    lines = [(n, plain) for n, line in text if (plain := re.sub(r"(^|\s)(#|//|%).*", "", line).strip())]
    expected: tuple[int, int] | None = None
    while lines and not _is_view(lines[0][1]):
        number, heading = lines.pop(0)
        counts = re.findall(r"\d+", heading)
        expected = (number, int(counts[0])) if len(counts) == 1 else expected
    if expected is not None and expected[1] != len(lines):
        raise DataError(
            f"{file}:{expected[0]}: the count line says {expected[1]} views, the file has {len(lines)}; "
            "correct the count or delete its line, if no view is missing"
        )
    if not lines:
        raise DataError(f"{file}: expected at least one view")
    return [_view(line, f"{file}:{number}") for number, line in lines]


def plain_name(name: str) -> str:
    r"""A photograph's name with / for \ and without ./ before it."""
    return re.sub(r"^(\./)+", "", re.sub(r"\\+", "/", name.strip().strip("\"'")))


def poses_of_lines(lines: Sequence[ParLine]) -> tuple[dict[str, NDArray[np.float64]], bool]:
    """Poses [R | t], or P where the lines give that, (3, 4), by where they stand; and whether the world was mirrored.

    Raises
    ------
    DataError : not all lines are of one kind, or they are of worlds of different handedness, or of no camera.
    """
    kinds = {len(line.numbers) in (_P, _P_SQUARE): line for line in lines}
    if len(kinds) > 1:
        raise DataError(f"{kinds[True].where}: expected K, R and t as on the other lines, got P")
    if False in kinds:
        return right_handed({line.where: _pose(line.numbers[9:]) for line in lines})
    matrices = {line.where: line.numbers.reshape(-1, 4)[:3] for line in lines}
    for where, P in matrices.items():
        if _is_rotation(P[:, :3]):
            raise DataError(f"{where}: {_EXPECTED}, got a pose [R | t] without K")
    return signed(matrices)


def camera_of_line(line: ParLine, pose: NDArray[np.float64], size: tuple[int, int]) -> Camera:
    """The camera of a line, for a photograph of a width and height.

    Parameters
    ----------
    pose : (3, 4) of ``poses_of_lines``.

    Raises
    ------
    DataError : the numbers are no camera; names file and line.
    """
    try:
        if len(line.numbers) in (_P, _P_SQUARE):
            return Camera.from_projection(pose, *size)
        return Camera(line.numbers[:9].reshape(3, 3), pose, *size)
    except ValueError as error:
        raise DataError(f"{line.where}: {error}") from None


def _pose(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 4) [R | t] of R and then t, (12,), or of the rows of [R | t], (12,) or (16,)."""
    rows = numbers[:12].reshape(3, 4)
    by_rows = len(numbers) == _P_SQUARE or (_is_rotation(rows[:, :3]) and not _is_rotation(numbers[:9].reshape(3, 3)))
    return rows if by_rows else np.column_stack([numbers[:9].reshape(3, 3), numbers[9:]])


def _is_view(line: str) -> bool:
    """Whether a line names a photograph, or at least holds more numbers than words."""
    name, rest = _split(line)
    words = [word for word in re.split(r"[\s,;:]+", rest) if word]
    numbers = sum(bool(re.match(r"[-+.\d]", word)) for word in words)
    return Path(name).suffix.lower() in IMAGE_SUFFIXES or (numbers > 1 and 2 * numbers > len(words))


def _split(line: str) -> tuple[str, str]:
    """Name and the rest of a line; a name may hold blanks if it is quoted or has the ending of an image."""
    if quoted := _QUOTED.fullmatch(line):
        return quoted[2], quoted[3]
    found = _WITH_ENDING.fullmatch(line) or _FIRST_FIELD.fullmatch(line)
    return (found[1], found[2]) if found else (line, "")


def _view(line: str, where: str) -> ParLine:
    name, rest = _split(line)
    fields = number_fields(rest, _COUNTS)
    numbers = []
    for field in fields:
        try:
            numbers.append(float(field))
        except ValueError:
            comma = "; write decimal points, or decimal commas throughout" if "," in field else ""
            raise DataError(f"{where}: expected a number, got {field!r}{comma}") from None
    surplus = len(numbers) - _KRT
    square = len(numbers) in (_P_SQUARE, _K_POSE) and numbers[-4:] == [0, 0, 0, 1]
    if len(numbers) not in (_KRT, _P) and not square:
        lens = (
            f"; {surplus} too many look like the distortion of a lens (k1, k2, p1, p2, k3): undistort the photographs "
            "first"
        )
        raise DataError(f"{where}: {_EXPECTED}, got {len(numbers)}{lens if surplus in (1, 2, 4, 5, 8) else ''}")
    return ParLine(where, plain_name(name), np.array(numbers))


def _is_rotation(R: NDArray[np.float64]) -> bool:
    """Whether a 3x3 matrix is a rotation or reflection."""
    return float(np.abs(R @ R.T - np.eye(3)).max()) < _ROTATION
