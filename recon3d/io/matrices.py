"""Projection matrices P, 3x4 or 4x4 with a last row 0 0 0 1, beside the photographs: as text, NumPy's or MATLAB's.

One file holds them all, or each photograph has its own: PMVS's ``txt/00000000.txt`` with the word CONTOUR, whose
photographs lie in ``visualize``, the VGG dinosaur's ``dino_Ps.mat``, and what people write themselves. A line of text
is a matrix or a row of one; a photograph's name may stand before it. Points of the world are taken to pixels, u to the
right, v down, with pixel centres at integers. P may have any factor; see ``handedness`` for its sign, and for a
left-handed world, which is mirrored.

References
----------
Furukawa, Ponce, "Accurate, Dense, and Robust Multiview Stereopsis", PAMI 2010 (PMVS)
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.handedness import signed
from recon3d.io.mat_file import read_mat
from recon3d.io.reading import (
    IMAGE_FOLDERS,
    UNIT_UNKNOWN,
    find_image,
    find_images,
    image_files,
    in_order,
    listed,
    natural,
    number_fields,
    numbered,
    read_text,
    views_named,
)
from recon3d.scene.camera import ROTATION_TOLERANCE, Camera
from recon3d.scene.mask_files import IMAGE_SUFFIXES
from recon3d.scene.photograph import Photograph

_FOLDERS = (
    "txt",
    "",
    "P",
    "Ps",
    "projections",
    "projection",
    "matrices",
    "calib",
    "calibration",
    "cameras",
    "cams",
    "pose",
    "poses",
)
_PHOTOGRAPHS = ("visualize", *IMAGE_FOLDERS)
_TEXT = frozenset({".txt", ".p", ".dat", ".csv", ".proj", ".projection"})
_SUFFIXES = _TEXT | {".npy", ".mat"}
_MOST = 16 * 2**20  # bytes of a file
_MANY = 100_000  # files of a folder, and matrices
_PROBED = 3  # files of one form that are looked at to recognise them
_SKEWED = 0.3  # of the focal length
_UNEVEN = 5.0  # ratio of the focal lengths
_COUNTS = (4, 12, 16)  # numbers of a line
_NAMED = re.compile(
    rf"(\S.*?(?:{'|'.join(map(re.escape, sorted(IMAGE_SUFFIXES)))}))(?:[\s,;:]+(.*)|)", re.IGNORECASE | re.DOTALL
)
_ADDED = re.compile(r"([._-](P|proj(ection)?|cam(era)?|matrix|calib))+$", re.IGNORECASE)


class _Matrix(NamedTuple):
    """A projection matrix and where it stands."""

    where: str
    name: str
    """Of the photograph; empty where the file does not say."""
    P: NDArray[np.float64]
    """(3, 4)."""


def is_matrices(path: Path) -> bool:
    """Whether a file, or a folder, holds projection matrices."""
    return bool(_files(path))


def read_matrices(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras and photographs.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : a matrix is malformed, they hold no intrinsics, or matrices and photographs do not go together.
    """
    files = _files(path)
    if not files:
        raise DataError(f"{path}: expected projection matrices, 3x4 numbers each")
    held = {file: list(islice(_matrices(file), _MANY)) for file in files}
    empty = next((file for file in files if not held[file]), None)
    if empty is not None:
        raise DataError(f"{empty}: expected a projection matrix of 3x4 numbers, got none")
    if all(_is_pose(matrix.P) for matrices in held.values() for matrix in matrices):
        raise DataError(
            f"{held[files[0]][0].where}: the left 3x3 parts are rotations: these are poses [R | t] alone, without K; "
            "give K and the poses to recon3d.Scene.from_arrays, or write P = K [R | t]"
        )
    whole = [file for file in files if len(held[file]) > 1]
    if len(whole) > 1:
        raise DataError(
            f"{files[0].parent}: expected one file of all projection matrices, or one a photograph, found several of "
            f"more: {', '.join(file.name for file in whole[:5])}; give the one that is meant"
        )
    scene = files[0].parent.parent if files[0].parent.name in _FOLDERS else files[0].parent
    folders = [images] if images else [place / name for place in (files[0].parent, scene) for name in _PHOTOGRAPHS]
    if whole:
        pairs = _pairs(held[whole[0]], folders, str(whole[0]))
    else:
        alone = [matrices[0]._replace(name=_ADDED.sub("", file.stem)) for file, matrices in held.items()]
        pairs = _pairs_of_files(alone, folders, str(files[0].parent))
    _warn_of_others(list(pairs), str((whole or files[:1])[0]))
    matrices, left_handed = signed({matrix.where: matrix.P for matrix in pairs.values()})
    calibrated = {}
    for image, (where, _, _) in pairs.items():
        photograph = Photograph(image)
        try:
            camera = Camera.from_projection(matrices[where], *photograph.size)
        except ValueError as error:
            raise DataError(f"{where}: {error}") from None
        calibrated[image] = CalibratedImage("", photograph, camera)
    return Calibrated(
        scene.resolve().name,
        views_named(calibrated),
        left_handed=left_handed,
        notes={"format": f"projection matrices ({(whole or files)[0].suffix[1:]})", **UNIT_UNKNOWN},
    )


def _files(path: Path) -> list[Path]:
    """Files whose first matrix is that of a camera."""
    if path.is_file():
        return [path] if _holds(path) else []
    for name in _FOLDERS:
        place = path / name
        listing = sorted(islice(place.iterdir(), _MANY), key=lambda file: natural(file.name)) if place.is_dir() else []
        by_form: dict[str, list[Path]] = {}
        for file in listing:
            by_form.setdefault(_form(file), []).append(file)
        forms = {form for form, alike in by_form.items() if any(_holds(file) for file in alike[:_PROBED])}
        if forms:
            return [file for file in listing if _form(file) in forms]
    return []


def _form(file: Path) -> str:
    """A name without its numbers, which files of one kind share."""
    return re.sub(r"\d+", "#", file.name)


def _holds(file: Path) -> bool:
    if file.suffix.lower() not in _SUFFIXES or not file.is_file() or file.stat().st_size > _MOST:
        return False
    try:
        first = next(_matrices(file), None)
    except DataError:
        return False
    return first is not None and _is_camera(first.P)


def _is_camera(P: NDArray[np.float64]) -> bool:
    """Whether numbers look like a projection matrix: pixels are nearly upright and nearly square."""
    try:
        K = Camera.from_projection(P if np.linalg.det(P[:, :3]) > 0 else -P, 1, 1).K
    except (ValueError, np.linalg.LinAlgError):
        return False
    fx, fy = K[0, 0], K[1, 1]
    return bool(abs(K[0, 1]) < _SKEWED * fx and 1 / _UNEVEN < fx / fy < _UNEVEN)


def _is_pose(P: NDArray[np.float64]) -> bool:
    """Whether a matrix is [R | t], of whatever factor."""
    R = P[:, :3] / max(float(np.linalg.norm(P[2, :3])), 1e-300)
    return bool(np.abs(R @ R.T - np.eye(3)).max() < ROTATION_TOLERANCE)


def _pairs(matrices: list[_Matrix], folders: list[Path], where: str) -> dict[Path, _Matrix]:
    """Photographs and matrices of one file: by the names in it, or in order."""
    names = [matrix.name for matrix in matrices]
    if all(names):
        if len(set(names)) < len(names):
            raise DataError(f"{where}: expected names that differ, got {max(names, key=names.count)} several times")
        found = find_images(names, folders, where)
        return {found[matrix.name]: matrix for matrix in matrices if matrix.name in found}
    photographs = next((files for files in map(image_files, folders) if files), [])
    return dict(zip(in_order(len(matrices), photographs, where), matrices, strict=True))


def _pairs_of_files(matrices: list[_Matrix], folders: list[Path], where: str) -> dict[Path, _Matrix]:
    """Photographs and matrices of their own files: by name, else by number, else in order."""
    for folder in folders:
        found = {matrix.name: image for matrix in matrices if (image := find_image(folder, matrix.name))}
        if len(found) == len(matrices):
            return {found[matrix.name]: matrix for matrix in matrices}
    ends = [re.search(r"(\d+)\D*$", matrix.name) for matrix in matrices]
    keys = [int(end[1]) if end else n for n, end in enumerate(ends)]
    photographs = next((files for files in map(image_files, folders) if files), [])
    if len(set(keys)) < len(keys):
        keys = list(range(len(matrices)))
    by_key = dict(zip(keys, matrices, strict=True))
    return {image: by_key[key] for key, image in numbered(keys, photographs, where).items()}


def _warn_of_others(taken: list[Path], where: str) -> None:
    """Name photographs that no matrix is for."""
    others = [image.name for image in image_files(taken[0].parent) if image not in taken]
    if others:
        warnings.warn(f"{where}: left out, there is no matrix for them: {listed(others)}", stacklevel=5)


def _matrices(file: Path) -> Iterator[_Matrix]:
    """Matrices of a file, one after another."""
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
            yield _Matrix(where, "", _checked(P, where))


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


def _of_text(file: Path) -> Iterator[_Matrix]:
    name, begun = "", str(file)
    rows: list[NDArray[np.float64]] = []
    for number, line in enumerate(read_text(file, _MOST).splitlines(), start=1):
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
            yield _Matrix(where, name, _checked(values.reshape(-1, 4), where))
            name = ""
            continue
        if not rows and (values == [0, 0, 0, 1]).all():
            continue  # the last row of a 4x4
        begun = begun if rows else where
        rows.append(values)
        if len(rows) == 3:
            yield _Matrix(begun, name, _checked(np.array(rows), begun))
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
