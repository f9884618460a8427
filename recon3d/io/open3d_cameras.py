"""Open3D's cameras: ``PinholeCameraTrajectory`` or several ``PinholeCameraParameters``, JSON, beside the photographs.

The extrinsic is world to camera with x right, y down, z forward, and pixel centres are at integers, as in recon3d.
Matrices are stored by columns. A trajectory names no photographs: they are taken in the order of the numbers in their
names.

References
----------
https://www.open3d.org/docs/release/python_api/open3d.camera.PinholeCameraTrajectory.html
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_json
from recon3d.io.photographs import (
    IMAGE_FOLDERS,
    camera_of,
    find_image,
    image_files,
    in_order,
    natural,
    photograph_of,
    views_named,
)

_HEAD = 100_000  # characters; the class's name stands behind a single camera's numbers, or before those of many
_MOST = 2000  # files that are looked at


def is_open3d(path: Path) -> bool:
    """Whether a folder holds cameras of Open3D's, or a file does."""
    return bool(_files(path))


def read_open3d(path: Path) -> Calibrated:
    """Cameras and photographs.

    Raises
    ------
    DataError : a file is malformed, or there are not as many photographs as cameras.
    """
    files = _files(path)
    if not files:
        raise DataError(f"{path}: expected a PinholeCameraTrajectory or PinholeCameraParameters, JSON")
    trajectory = next((file for file, kind in files.items() if kind == "PinholeCameraTrajectory"), None)
    folder = next(iter(files)).parent
    folders = [folder / name for name in IMAGE_FOLDERS]
    photographs = next((found for found in map(image_files, folders) if found), [])
    if trajectory is not None:
        entries = read_json(trajectory).get("parameters")
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise DataError(f"{trajectory}: expected a list 'parameters' of cameras")
        cameras = [(f"{trajectory}: camera {n}", entry) for n, entry in enumerate(entries)]
        paths = in_order(len(cameras), photographs, str(trajectory))
    else:
        single = sorted(files, key=lambda file: natural(file.name))
        cameras = [(str(file), read_json(file)) for file in single]
        by_name = [
            next((image for place in folders if (image := find_image(place, file.stem))), None) for file in single
        ]
        named = [image for image in by_name if image is not None]
        paths = named if len(named) == len(single) else in_order(len(cameras), photographs, str(folder))
    images = {image: _image(image, *camera) for image, camera in zip(paths, cameras, strict=True)}
    return Calibrated(folder.resolve().name, views_named(images), notes={"format": "Open3D"})


def _files(path: Path) -> dict[Path, str]:
    """Files of cameras, and of which class each is."""
    files = [path] if path.is_file() else sorted(path.glob("*.json"))[:_MOST]
    kinds = {file: _kind(file) for file in files if file.suffix.lower() == ".json"}
    return {file: kind for file, kind in kinds.items() if kind}


def _kind(file: Path) -> str:
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        head = opened.read(_HEAD)
    kinds = ("PinholeCameraTrajectory", "PinholeCameraParameters")
    return next((kind for kind in kinds if f'"{kind}"' in head), "")


def _image(path: Path, where: str, entry: Mapping[str, Any]) -> CalibratedImage:
    intrinsic = entry.get("intrinsic")
    if not isinstance(intrinsic, dict):
        raise DataError(f"{where}: expected an object 'intrinsic'")
    K = _by_columns(intrinsic.get("intrinsic_matrix"), 3, f"{where}: intrinsic_matrix")
    pose = _by_columns(entry.get("extrinsic"), 4, f"{where}: extrinsic")
    size = None
    if intrinsic.get("width", -1) not in (-1, 0, None):
        width, height = numbers((intrinsic["width"], intrinsic.get("height")), 2, f"{where}: width and height")
        size = int(width), int(height)
    photograph = photograph_of(path, size, stored=False)
    return CalibratedImage("", photograph, camera_of(K, pose, size, photograph, where))


def _by_columns(entries: object, n: int, where: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return numbers(entries if isinstance(entries, list) else (), n * n, where).reshape(n, n).T
