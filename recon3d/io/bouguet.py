"""``Calib_Results.m`` of Bouguet's Camera Calibration Toolbox for MATLAB: one lens, and a pose of each image.

The file is a MATLAB script; its assignments of numbers are read as data and nothing of it is run. ``omc_k`` and
``Tc_k``, a rotation vector and a translation, are world to camera with x right, y down, z forward, the upper left
pixel's centre is (0, 0), and ``kc`` is k1, k2, p1, p2, k3: as in recon3d. The skew is ``alpha_c`` times the first focal
length. Every image sees the calibration board where its own world frame begins; cameras are of one world only where
the board did not move.

References
----------
Bouguet, "Camera Calibration Toolbox for MATLAB", 2004, "Description of the calibration parameters".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_text, whole
from recon3d.io.photographs import (
    IMAGE_FOLDERS,
    camera_of,
    image_files,
    listed,
    numbered,
    photograph_of,
    pinhole,
    views_named,
)

_MOST = 4 * 2**20  # bytes
_HEAD = 2**16
_ASSIGNED = re.compile(r"(?<![\w.])([A-Za-z]\w*)[ \t]*=[ \t]*(\[[^\[\]=]*\]|[-+.\w]+)")


def is_bouguet(path: Path) -> bool:
    """Whether a folder holds results of the toolbox, or a file is one."""
    return _file(path) is not None


def read_bouguet(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras and photographs; images that were not used in the calibration are left out.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : a number is missing or malformed, or images and photographs do not go together.
    """
    file = _file(path)
    if file is None:
        raise DataError(f"{path}: expected Calib_Results.m of Bouguet's toolbox")
    values = _assigned(read_text(file, _MOST))
    fx, fy = _vector(values, "fc", 2, file)
    cx, cy = _vector(values, "cc", 2, file)
    skew = fx * float(_vector(values, "alpha_c", 1, file)[0]) if "alpha_c" in values else 0.0
    distortion = _vector(values, "kc", (4, 5), file) if "kc" in values else np.zeros(0)
    width, height = (whole(_vector(values, side, 1, file)[0], f"{file}: {side}") for side in ("nx", "ny"))
    keys = sorted(int(name.removeprefix("omc_")) for name in values if re.fullmatch(r"omc_\d{1,6}", name))
    used = [key for key in keys if not {"nan"} & {word.lower() for word in values[f"omc_{key}"]}]
    folders = [images] if images else [file.parent / name for name in IMAGE_FOLDERS]
    photographs = next((files for files in map(image_files, folders) if files), [])
    calibrated = {}
    for key, image in numbered(keys, photographs, str(file)).items():
        if key not in used:
            continue
        turn, t = _vector(values, f"omc_{key}", 3, file), _vector(values, f"Tc_{key}", 3, file)
        pose = np.column_stack([np.asarray(cv2.Rodrigues(turn)[0], np.float64), t])
        photograph = photograph_of(image, (width, height), stored=True)
        K, where = pinhole(fx, fy, cx, cy, skew), f"{file}: image {key}"
        calibrated[image] = CalibratedImage(
            "", photograph, camera_of(K, pose, (width, height), photograph, where, distortion)
        )
    if not calibrated:
        raise DataError(f"{file}: expected omc_1, Tc_1 and so on of at least one image and its photograph, found none")
    notes = {"format": "Bouguet"}
    if len(used) < len(keys):
        notes["left out"] = f"not calibrated: images {listed([str(key) for key in keys if key not in used])}"
    return Calibrated(file.parent.resolve().name, views_named(calibrated), notes=notes)


def _file(path: Path) -> Path | None:
    files = [path] if path.is_file() else sorted(path.glob("*.m"))
    return next((file for file in files if file.suffix.lower() == ".m" and _is_results(file)), None)


def _is_results(file: Path) -> bool:
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        head = opened.read(_HEAD)
    return all(re.search(rf"^\s*{name}\s*=", head, re.MULTILINE) for name in ("fc", "cc", "omc_1"))


def _assigned(text: str) -> dict[str, list[str]]:
    """Words of what is assigned to each name, without comments."""
    plain = re.sub(r"%[^\n]*", "", text.replace("\r", "\n"))
    return {name: re.split(r"[\s,;]+", words.strip("[] \t\r\n,;")) for name, words in _ASSIGNED.findall(plain)}


def _vector(
    values: Mapping[str, list[str]], name: str, count: int | tuple[int, ...], file: Path
) -> NDArray[np.float64]:
    if name not in values:
        raise DataError(f"{file}: expected {name} = ..., it is not there")
    return numbers(values[name], count, f"{file}: {name}")
