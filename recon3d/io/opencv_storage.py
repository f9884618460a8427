"""OpenCV's ``FileStorage``, YAML or XML: one K and distortion, and rvec and tvec of each image.

Poses are world to camera with x right, y down, z forward, and pixel centres are at integers: OpenCV's conventions are
recon3d's. Names differ from program to program; the usual ones are known, see ``_K`` and the others below.

References
----------
https://docs.opencv.org/5.x/d4/da4/group__core__xml.html
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers
from recon3d.io.photographs import (
    IMAGE_FOLDERS,
    camera_of,
    find_images,
    image_files,
    in_order,
    natural,
    photograph_of,
    views_named,
)

_K = ("cameramatrix", "k", "intrinsicmatrix", "intrinsics", "intrinsic", "mtx", "m1", "m")
_DISTORTION = ("distortioncoefficients", "distcoeffs", "distcoeff", "dist", "distortion", "d1", "d")
_WIDTH, _HEIGHT = ("imagewidth", "width"), ("imageheight", "height")
_ROTATION = ("rvec", "rotation", "r")
_TRANSLATION = ("tvec", "translation", "t")
_MANY = ("extrinsicparameters", "extrinsics")
_MOST = 16 * 2**20  # bytes
_HEAD = 4096
_LARGEST = 1_000_000  # numbers of a matrix


def is_opencv_storage(path: Path) -> bool:
    """Whether a folder holds a calibration of OpenCV's, or a file is one."""
    return _file(path) is not None


def read_opencv_storage(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras and photographs.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : the file is malformed, has no K or no poses, or photographs are missing.
    """
    file = _file(path)
    if file is None:
        raise DataError(f"{path}: expected a calibration of OpenCV's FileStorage")
    if file.stat().st_size > _MOST:
        raise DataError(f"{file}: expected at most {_MOST // 2**20} MiB")
    try:
        storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
        held = dict(_matrices(storage.root()))
        storage.release()
    except (cv2.error, SystemError) as error:  # OpenCV's constructors raise the latter because of the former
        cause = error.__cause__ or error
        raise DataError(f"{file}: not readable as FileStorage: {getattr(cause, 'err', cause)}") from None
    known = {_plain(name): value for name, value in held.items()}
    K = next((known[name] for name in _K if name in known), None)
    if K is None or K.size != 9:
        raise DataError(f"{file}: expected a 3x3 camera_matrix, found {', '.join(sorted(held)) or 'nothing'}")
    distortion = next((known[name].ravel() for name in _DISTORTION if name in known), np.zeros(0))
    width, height = (
        next((int(known[name].ravel()[0]) for name in side if name in known), 0) for side in (_WIDTH, _HEIGHT)
    )
    size = (width, height) if width > 0 and height > 0 else None
    poses = _poses(held, str(file))
    folders = [images] if images else [file.parent / name for name in IMAGE_FOLDERS]
    if all(re.fullmatch(r"\d*", name) for name in poses):
        files = next((found for found in map(image_files, folders) if found), [])
        found = dict(zip(sorted(poses, key=natural), in_order(len(poses), files, str(file)), strict=True))
    else:
        found = find_images(list(poses), folders, str(file))
    calibrated = {}
    for name, image in found.items():
        photograph = photograph_of(image, size, stored=False)
        camera = camera_of(K.reshape(3, 3), poses[name], size, photograph, f"{file}: {name}", distortion)
        calibrated[image] = CalibratedImage("", photograph, camera)
    return Calibrated(file.parent.resolve().name, views_named(calibrated), notes={"format": "OpenCV FileStorage"})


def _file(path: Path) -> Path | None:
    files = (
        [path] if path.is_file() else [file for end in ("yml", "yaml", "xml") for file in sorted(path.glob(f"*.{end}"))]
    )
    return next((file for file in files if _is_storage(file)), None)


def _is_storage(file: Path) -> bool:
    """Whether a file is a FileStorage that holds matrices."""
    if file.suffix.lower() not in (".yml", ".yaml", ".xml"):
        return False
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        head = opened.read(_HEAD)
    return ("%YAML" in head and "!!opencv-" in head) or "<opencv_storage>" in head


def _matrices(node: cv2.FileNode, prefix: str = "") -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Names and numbers of all matrices and numbers, those of nested maps as outer_inner."""
    for name in node.keys():  # noqa: SIM118 -- a node is no dict
        child, full = node.getNode(name), f"{prefix}{name}"
        if child.isReal() or child.isInt():
            yield full, np.array([child.real()])
        elif child.isMap() and "data" not in child.keys():  # noqa: SIM118
            yield from _matrices(child, f"{full}_")
        elif child.isMap():
            matrix = child.mat()
            if matrix is not None and 0 < matrix.size <= _LARGEST and np.issubdtype(matrix.dtype, np.number):
                yield full, np.asarray(matrix, np.float64)
        elif child.isSeq() and 0 < child.size() <= _LARGEST:
            items = [child.at(n) for n in range(child.size())]
            if all(item.isReal() or item.isInt() for item in items):
                yield full, np.array([item.real() for item in items])
            elif all(item.isMap() for item in items):
                for n, item in enumerate(items):
                    vector = item.mat() if "data" in item.keys() else None  # noqa: SIM118
                    if vector is not None and 0 < vector.size <= _LARGEST:
                        yield f"{full}_{n}", np.asarray(vector, np.float64)


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name).lower()


def _poses(held: dict[str, NDArray[np.float64]], where: str) -> dict[str, NDArray[np.float64]]:
    """(3, 4) world to camera by image's name, or by number where the file names none."""
    for name, value in held.items():
        if _plain(name) in _MANY and value.ndim == 2 and value.shape[1] == 6:
            return {str(n): _pose(row[:3], row[3:], f"{where}: {name}, row {n}") for n, row in enumerate(value)}
    rotations, translations = (_by_image(held, words) for words in (_ROTATION, _TRANSLATION))
    both = [name for name in rotations if name in translations]
    if not both or len(both) < max(len(rotations), len(translations)):
        alone = sorted((rotations.keys() | translations.keys()) - set(both))
        raise DataError(
            f"{where}: expected rvec and tvec of each image, as rvec_view01 and tvec_view01; "
            + (f"{', '.join(alone[:5])} has one alone" if alone else f"found {', '.join(sorted(held)[:8])}")
        )
    return {name: _pose(rotations[name], translations[name], f"{where}: {name}") for name in both}


def _by_image(held: dict[str, NDArray[np.float64]], words: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    """Vectors by the rest of their names, with one of the words, in the singular or plural, before or behind it."""
    pattern = "|".join(words)
    found = {}
    for name, value in held.items():
        match = re.fullmatch(rf"(?:{pattern})s?(?:[_.-]|(?=\d))(.+)", name, re.IGNORECASE) or re.fullmatch(
            rf"(.+)[_.-](?:{pattern})s?", name, re.IGNORECASE
        )
        if match and value.size in (3, 9):
            found[match[1]] = value
        elif (
            re.fullmatch(rf"(?:{pattern})s?", name, re.IGNORECASE)
            and value.ndim == 2
            and value.shape[1] == 3 < len(value)
        ):
            found.update({str(n): row for n, row in enumerate(value)})
    return found


def _pose(rotation: NDArray[np.float64], translation: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    t = numbers(translation.ravel(), 3, where)
    turn = numbers(rotation.ravel(), (3, 9), where)
    R = np.asarray(cv2.Rodrigues(turn)[0], np.float64) if len(turn) == 3 else turn.reshape(3, 3)
    return np.column_stack([R, t])
