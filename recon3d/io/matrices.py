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
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.handedness import signed
from recon3d.io.matrix_files import MOST, SUFFIXES, Matrix, matrices_in
from recon3d.io.photographs import (
    IMAGE_FOLDERS,
    find_image,
    find_images,
    image_files,
    in_order,
    listed,
    natural,
    numbered,
    views_named,
)
from recon3d.scene.camera import ROTATION_TOLERANCE, Camera
from recon3d.scene.photograph import Photograph

_FOLDERS = (
    "txt", "", "P", "Ps", "projections", "projection", "matrices", "calib", "calibration", "cameras", "cams", "pose",
    "poses",
)  # fmt: skip
_PHOTOGRAPHS = ("visualize", *IMAGE_FOLDERS)
_MANY = 100_000  # files of a folder, and matrices
_PROBED = 3  # files of one form that are looked at to recognise them
_SKEWED = 0.3  # of the focal length
_UNEVEN = 5.0  # ratio of the focal lengths
_ADDED = re.compile(r"([._-](P|proj(ection)?|cam(era)?|matrix|calib))+$", re.IGNORECASE)


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
    held = {file: list(islice(matrices_in(file), _MANY)) for file in files}
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
        notes={"format": f"projection matrices ({(whole or files)[0].suffix[1:]})"},
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
    if file.suffix.lower() not in SUFFIXES or not file.is_file() or file.stat().st_size > MOST:
        return False
    try:
        first = next(matrices_in(file), None)
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


def _pairs(matrices: list[Matrix], folders: list[Path], where: str) -> dict[Path, Matrix]:
    """Photographs and matrices of one file: by the names in it, or in order."""
    names = [matrix.name for matrix in matrices]
    if all(names):
        if len(set(names)) < len(names):
            raise DataError(f"{where}: expected names that differ, got {max(names, key=names.count)} several times")
        found = find_images(names, folders, where)
        return {found[matrix.name]: matrix for matrix in matrices if matrix.name in found}
    photographs = next((files for files in map(image_files, folders) if files), [])
    return dict(zip(in_order(len(matrices), photographs, where), matrices, strict=True))


def _pairs_of_files(matrices: list[Matrix], folders: list[Path], where: str) -> dict[Path, Matrix]:
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
