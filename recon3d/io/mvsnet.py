"""MVSNet's ``cams/*_cam.txt``, as of MVSNet, its successors, BlendedMVS and DTU's training files.

``extrinsic`` is world to camera with x right, y down, z forward and ``intrinsic`` is K with pixel centres at integers,
as in recon3d. Training files have K at a quarter of the photographs' size; it is scaled up where it plainly is.

References
----------
https://github.com/YoYo000/MVSNet
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers
from recon3d.io.photographs import IMAGE_FOLDERS, camera_of, image_files, numbered, views_named
from recon3d.scene.photograph import Photograph

_CAMERAS = ("cams", "cameras", "cams_1", "")
_PHOTOGRAPHS = ("blended_images", *IMAGE_FOLDERS)
_FRACTIONS = (2, 4, 8)  # of the photographs' size that K may be of


def is_mvsnet(path: Path) -> bool:
    """Whether a folder holds ``cams/*_cam.txt``."""
    return path.is_dir() and bool(_files(path))


def read_mvsnet(path: Path) -> Calibrated:
    """Cameras and photographs.

    Raises
    ------
    DataError : a file is malformed, or cameras and photographs do not go together.
    """
    files = _files(path)
    scene = path.resolve().parent if path.resolve().name in _CAMERAS else path
    photographs = next((found for name in _PHOTOGRAPHS if (found := image_files(scene / name))), [])
    images, fractions = {}, set()
    for key, image in numbered(list(files), photographs, str(path)).items():
        extrinsic, intrinsic = _read(files[key])
        photograph = Photograph(image)
        K, fraction = _whole(intrinsic, photograph.size)
        fractions.add(fraction)
        images[image] = CalibratedImage("", photograph, camera_of(K, extrinsic, None, photograph, str(files[key])))
    if fractions != {1}:
        warnings.warn(
            f"{path}: K is of 1/{max(fractions)} of the photographs' size, as its principal point says: scaled",
            stacklevel=4,
        )
    return Calibrated(scene.resolve().name, views_named(images), notes={"format": "MVSNet"})


def _files(path: Path) -> dict[int, Path]:
    """Files of cameras by number."""
    for name in _CAMERAS:
        found = {
            int(number[1]): file
            for file in sorted((path / name).glob("*_cam.txt"))
            if (number := re.search(r"(\d+)_cam$", file.stem))
        }
        if found:
            return found
    return {}


def _read(file: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(4, 4) extrinsic and (3, 3) intrinsic matrix."""
    words = file.read_text(encoding="utf-8-sig", errors="replace").split()
    try:
        first, second = words.index("extrinsic") + 1, words.index("intrinsic") + 1
    except ValueError:
        raise DataError(f"{file}: expected the words extrinsic and intrinsic, each before its matrix") from None
    extrinsic = numbers(words[first : first + 16], 16, f"{file}: extrinsic")
    return extrinsic.reshape(4, 4), numbers(words[second : second + 9], 9, f"{file}: intrinsic").reshape(3, 3)


def _whole(K: NDArray[np.float64], size: tuple[int, int]) -> tuple[NDArray[np.float64], int]:
    """K of a whole photograph, and the fraction of its size that it was of."""
    off = {n: np.abs(n * K[:2, 2] / size - 0.5).max() for n in (1, *_FRACTIONS)}
    fraction = min(off, key=lambda n: off[n]) if off[1] > 0.2 else 1
    if fraction == 1:
        return K, 1
    shift = (fraction - 1) / 2  # pixel centres are at integers
    return np.array([[fraction, 0, shift], [0, fraction, shift], [0, 0, 1]]) @ K, fraction
