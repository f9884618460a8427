"""Bundler's ``bundle.out`` (v0.3), and ``list.txt``, which names the photographs.

R and t are world to camera, but the camera looks along -z with x right and y up: y and z are turned over. Pixels are
counted from the image's middle, which the format takes for the principal point, and 1 + k1 r² + k2 r⁴ is OpenCV's
radial distortion. Cameras with a focal length of 0 were not registered.

References
----------
Snavely, "Bundler v0.4 User's Manual", 2010, section "Output format and scene representation".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_text
from recon3d.io.photographs import (
    IMAGE_FOLDERS,
    camera_of,
    find_images,
    image_files,
    in_order,
    listed,
    photograph_of,
    pinhole_from_corner,
    views_named,
)

_HEADER = "# Bundle file v"
_FOLDERS = ("", "bundle", "bundler")
_LISTS = ("list.txt", "list.rd.txt", "image_list.txt")
_FROM_BUNDLER = np.diag([1.0, -1.0, -1.0])
_LEAST_CAMERA, _LEAST_POINT = 30, 14  # bytes


class _Camera(NamedTuple):
    """A camera as it is written."""

    focal: float
    radial: NDArray[np.float64]
    """(2,) k1, k2."""
    cam_from_world: NDArray[np.float64]
    """(3, 4), Bundler's axes."""


class _Lines:
    """Lines of a file that hold something, one after another."""

    def __init__(self, file: Path) -> None:
        text = read_text(file)
        self._file, self._size = file, len(text)
        self._lines = ((n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip())
        self._last = 0

    def numbers(self, count: int, what: str) -> NDArray[np.float64]:
        """Those of the next line."""
        line = self.line(what)
        return numbers(line.split(), count, f"{self._file}:{self._last}: {what}")

    def line(self, what: str) -> str:
        """The next one."""
        number, line = next(self._lines, (None, ""))
        if number is None:
            raise DataError(f"{self._file}: the file ends behind line {self._last}, expected {what}")
        self._last = number
        return line.strip()

    def count(self, value: float, least: int, what: str) -> int:
        """A number of items, each of so many bytes at least."""
        if value != int(value) or not 0 <= value * least <= self._size:
            raise DataError(f"{self._file}:{self._last}: the file cannot hold {value:g} {what}")
        return int(value)


def is_bundler(path: Path) -> bool:
    """Whether a folder holds a file of Bundler's, or a file is one."""
    return _file(path) is not None


def read_bundler(path: Path, images: Path | None = None) -> Calibrated:
    """Registered cameras, their photographs and the points.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : the file is malformed or of another version, or no photograph is there.
    """
    file = _file(path)
    if file is None:
        raise DataError(f"{path}: expected a bundle.out of Bundler")
    cameras, points = _read(file)
    scene = file.parent.parent if file.parent.name in _FOLDERS else file.parent
    places = list(dict.fromkeys((file.parent, scene)))
    folders = [images] if images else [place / name for place in places for name in IMAGE_FOLDERS]
    photographs, note = _photographs(len(cameras), places, folders, file)
    calibrated = {
        image: _image(image, cameras[n], f"{file}: camera {n}") for n, image in photographs.items() if cameras[n].focal
    }
    if not calibrated:
        raise DataError(f"{file}: expected a registered camera whose photograph is there, got none")
    notes = {
        "format": f"Bundler ({file.name})",
        "principal point": "taken to be the images' middle: the format has none",
        **note,
    }
    lost = [str(n) for n, camera in enumerate(cameras) if not camera.focal]
    if lost:
        notes["left out"] = f"cameras that are not registered: {listed(lost)}"
    return Calibrated(
        scene.resolve().name, views_named(calibrated), points=points if len(points) else None, notes=notes
    )


def _file(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == ".out" and _is_bundle(path) else None
    files = (file for name in _FOLDERS for file in sorted((path / name).glob("*.out")))
    return max((file for file in files if _is_bundle(file)), key=lambda file: file.stat().st_size, default=None)


def _is_bundle(file: Path) -> bool:
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        return opened.read(len(_HEADER)) == _HEADER


def _read(file: Path) -> tuple[list[_Camera], NDArray[np.float64]]:
    """Cameras, and (n, 3) points, world."""
    lines = _Lines(file)
    version = lines.line("the version").removeprefix(_HEADER)
    if version != "0.3":
        raise DataError(f"{file}:1: expected version 0.3 of the format, got {version}")
    counts = lines.numbers(2, "the numbers of cameras and points")
    n_cameras = lines.count(counts[0], _LEAST_CAMERA, "cameras")
    n_points = lines.count(counts[1], _LEAST_POINT, "points")
    cameras = []
    for n in range(n_cameras):
        focal, *radial = lines.numbers(3, f"f, k1, k2 of camera {n}")
        R = [lines.numbers(3, f"a row of R of camera {n}") for _ in range(3)]
        t = lines.numbers(3, f"t of camera {n}")
        cameras.append(_Camera(float(focal), np.array(radial), np.column_stack([R, t])))
    points = []
    for n in range(n_points):
        points.append(lines.numbers(3, f"point {n}"))
        lines.line(f"the colour of point {n}")
        lines.line(f"the views of point {n}")
    return cameras, np.array(points).reshape(-1, 3)


def _photographs(n: int, places: list[Path], folders: list[Path], file: Path) -> tuple[dict[int, Path], dict[str, str]]:
    """Photographs by the cameras' numbers: those of the list, or in the order of their names, and then a note of it."""
    beside = (place / name for place in places for name in _LISTS)
    table = next((table for table in beside if table.is_file()), None)
    if table is None:
        files = next((files for files in map(image_files, folders) if files), [])
        return dict(enumerate(in_order(n, files, str(file)))), {
            "photographs": "in the order of their names: there is no list.txt"
        }
    # A line is a name, or a name, 0 and the focal length that the photograph's EXIF says.
    lines = [line.strip() for line in read_text(table).splitlines() if line.strip()]
    names = [re.sub(r"\s+0(\s+[-+.\deE]+)?$", "", line) for line in lines]
    if len(names) != n:
        raise DataError(f"{table}: expected a photograph for each of {n} cameras of {file.name}, got {len(names)}")
    found = find_images(names, folders, str(table))
    return {number: found[name] for number, name in enumerate(names) if name in found}, {}


def _image(path: Path, camera: _Camera, where: str) -> CalibratedImage:
    photograph = photograph_of(path, None, stored=True)
    width, height = photograph.size
    K = pinhole_from_corner(camera.focal, camera.focal, width / 2, height / 2)
    pose = _FROM_BUNDLER @ camera.cam_from_world
    return CalibratedImage("", photograph, camera_of(K, pose, None, photograph, where, (*camera.radial, 0.0, 0.0)))
