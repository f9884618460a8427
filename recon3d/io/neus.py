"""``cameras_sphere.npz`` of IDR, VolSDF and NeuS: projection matrices, beside ``image`` and ``mask``.

``world_mat_N`` is P = K [R | t], 4x4, world to pixels, with x right, y down, z forward and pixel centres at integers,
as in recon3d. ``scale_mat_N`` takes the unit sphere around the object to the world: the bounds. World units are those
of ``world_mat``, millimetres in DTU's scans.

References
----------
https://github.com/Totoro97/NeuS (models/dataset.py)
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.middlebury import read_padded_bounds
from recon3d.io.photographs import IMAGE_FOLDERS, image_files, numbered, views_named
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.photograph import Photograph

_NAMES = ("cameras_sphere.npz", "cameras.npz", "cameras_large.npz")
_MILLIMETRES = 20.0  # radius of the object's sphere from which on the world is taken to be in millimetres


def is_neus(path: Path) -> bool:
    """Whether a folder holds such a file, or a file is one."""
    return _file(path) is not None


def read_neus(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras, photographs and bounds.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : the file is malformed, or matrices and photographs do not go together.
    """
    file = _file(path)
    if file is None:
        raise DataError(f"{path}: expected a folder with {' or '.join(_NAMES)}")
    matrices = _matrices(file)
    keys = sorted(int(key.removeprefix("world_mat_")) for key in matrices if re.fullmatch(r"world_mat_\d+", key))
    if not keys:
        raise DataError(f"{file}: expected matrices world_mat_0 and so on, got {', '.join(sorted(matrices)[:6])}")
    folders = [images] if images else [file.parent / name for name in IMAGE_FOLDERS]
    photographs = numbered(keys, next((files for files in map(image_files, folders) if files), []), str(file))
    sphere = _bounds(matrices.get(f"scale_mat_{keys[0]}"), file)
    center = None if sphere is None else sphere.center
    calibrated = {}
    for key, image in photographs.items():
        photograph = Photograph(image)
        try:
            camera = Camera.from_projection(matrices[f"world_mat_{key}"], *photograph.size, seen=center)
        except ValueError as error:
            raise DataError(f"{file}: world_mat_{key}: {error}") from None
        calibrated[image] = CalibratedImage("", photograph, camera)
    millimetres = sphere is not None and sphere.longest / 2 >= _MILLIMETRES
    unit = {"unit": "taken for a millimetre, the object's sphere being so large"} if millimetres else {}
    return Calibrated(
        file.parent.resolve().name,
        views_named(calibrated),
        bounds=_tighter(sphere, file.parent),
        mm_per_unit=1.0 if millimetres else None,
        notes={"format": f"{file.name} (IDR, NeuS)", **unit},
    )


def _tighter(sphere: Bounds | None, folder: Path) -> Bounds | None:
    """The box of a README where it lies in the sphere's, which is far larger than most objects."""
    try:
        box = read_padded_bounds(folder)
    except DataError:
        return sphere
    held = (
        sphere is not None
        and (np.subtract(box.low, sphere.low) >= 0).all()
        and (np.subtract(sphere.high, box.high) >= 0).all()
    )
    return box if held else sphere


def _file(path: Path) -> Path | None:
    if path.is_file():
        return path if path.name in _NAMES else None
    return next((path / name for name in _NAMES if (path / name).is_file()), None)


def _matrices(file: Path) -> dict[str, NDArray[np.float64]]:
    """The file's 4x4 matrices by name."""
    try:
        with np.load(file, allow_pickle=False) as held:
            wanted = [name for name in held.files if re.fullmatch(r"(world|scale)_mat_\d+", name)]
            found = {name: np.asarray(held[name], np.float64) for name in wanted}
    except (ValueError, OSError, EOFError, TypeError, zipfile.BadZipFile) as error:
        raise DataError(f"{file}: not readable as NPZ: {error}") from None
    for name, matrix in found.items():
        if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
            raise DataError(f"{file}: expected 4x4 finite numbers as {name}, got shape {matrix.shape}")
    return found


def _bounds(scale: NDArray[np.float64] | None, file: Path) -> Bounds | None:
    """Cube around the sphere that a unit sphere is taken to."""
    if scale is None:
        return None
    radius = float(np.cbrt(abs(np.linalg.det(scale[:3, :3]))))
    if not radius > 0:
        raise DataError(f"{file}: expected a scale_mat that can be undone")
    return Bounds(scale[:3, 3] - radius, scale[:3, 3] + radius)
