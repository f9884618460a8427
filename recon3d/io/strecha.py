"""Strecha's ``*.camera``, a file a photograph, as of fountain-P11: K, distortion, rotation, centre, size.

The rotation is camera to world, with x right, y down, z forward in the camera, and the camera's centre follows, so that
P = K [Rᵀ | -Rᵀ C]. Pixel centres are taken to be at integers. The line of distortion is zero in the published sets;
what other numbers would mean is not documented, and they are refused.

References
----------
Strecha, von Hansen, Van Gool, Fua, Thoennessen, "On Benchmarking Camera Calibration and Multi-View Stereo for High
Resolution Imagery", CVPR 2008.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_text, whole
from recon3d.io.photographs import IMAGE_FOLDERS, camera_of, find_images, natural, photograph_of, views_named

_FOLDERS = ("", "gt_dense_cameras", "cameras", "gt_sparse_cameras")
_COUNT = 9 + 3 + 9 + 3 + 2
_MOST = 2**16  # bytes of a file


def is_strecha(path: Path) -> bool:
    """Whether a folder holds ``*.camera``."""
    return bool(_files(path))


def read_strecha(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras and photographs.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : a file is malformed, its lens has a distortion, or no photograph is there.
    """
    files = _files(path)
    if not files:
        raise DataError(f"{path}: expected files *.camera")
    scene = files[0].parent if files[0].parent.name not in _FOLDERS else files[0].parent.parent
    places = [images] if images else [place / name for place in (scene, files[0].parent) for name in IMAGE_FOLDERS]
    found = find_images([file.stem for file in files], places, str(files[0].parent))
    calibrated = {found[file.stem]: _image(found[file.stem], file) for file in files if file.stem in found}
    notes = {"format": "Strecha", "unit": "taken for a metre, as in Strecha's own sets"}
    return Calibrated(scene.resolve().name, views_named(calibrated), mm_per_unit=1000.0, notes=notes)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    found = (sorted((path / name).glob("*.camera"), key=lambda file: natural(file.name)) for name in _FOLDERS)
    return next((files for files in found if files), [])


def _image(path: Path, file: Path) -> CalibratedImage:
    values = numbers(read_text(file, _MOST).split(), _COUNT, str(file))
    K, distortion, rotation, center, size = np.split(values, np.cumsum([9, 3, 9, 3]))
    if distortion.any():
        raise DataError(
            f"{file}: expected 0 0 0 behind K, got the distortion {distortion}, whose model is not documented; "
            "undistort the photographs first"
        )
    R = rotation.reshape(3, 3).T
    width, height = (whole(side, f"{file}: width and height") for side in size)
    photograph = photograph_of(path, (width, height), stored=False)
    pose = np.column_stack([R, -R @ center])
    camera = camera_of(K.reshape(3, 3) / K[8], pose, (width, height), photograph, str(file))
    return CalibratedImage("", photograph, camera)
