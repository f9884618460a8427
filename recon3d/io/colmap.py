"""COLMAP models, text or binary: ``cameras``, ``images`` and ``points3D``, and the photographs beside them.

COLMAP's poses are world to camera with x right, y down, z forward, as recon3d's. Its pixels are counted from the
image's corner: the upper left pixel's centre is (½, ½), so that half a pixel is taken off cx and cy.

References
----------
https://colmap.github.io/format.html
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers
from recon3d.io.photographs import IMAGE_FOLDERS, camera_of, find_images, photograph_of, pinhole_from_corner

_MODELS = (
    "", "sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse", "dense/0/sparse",
    "undistorted/sparse/0", "undistorted/sparse", "sparse_text", "colmap_text", "model", "0",
)  # fmt: skip
"""Where a model lies in the folder that people hand over."""


class _Model(NamedTuple):
    """A camera model: its name, and how many parameters it has."""

    name: str
    parameters: int


_BY_ID = {
    0: _Model("SIMPLE_PINHOLE", 3),
    1: _Model("PINHOLE", 4),
    2: _Model("SIMPLE_RADIAL", 4),
    3: _Model("RADIAL", 5),
    4: _Model("OPENCV", 8),
    5: _Model("OPENCV_FISHEYE", 8),
    6: _Model("FULL_OPENCV", 12),
    7: _Model("FOV", 5),
    8: _Model("SIMPLE_RADIAL_FISHEYE", 4),
    9: _Model("RADIAL_FISHEYE", 5),
    10: _Model("THIN_PRISM_FISHEYE", 12),
    11: _Model("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_READ = {model.name: model.parameters for number, model in _BY_ID.items() if number in (0, 1, 2, 3, 4, 6)}
"""Models that OpenCV undoes; the parameters after the principal point are OpenCV's coefficients, in their order."""


class _Lens(NamedTuple):
    """A camera of a model."""

    name: str
    size: tuple[int, int]
    parameters: NDArray[np.float64]


class _Image(NamedTuple):
    """An image of a model."""

    name: str
    pose: NDArray[np.float64]
    """(7,) quaternion w, x, y, z and translation."""
    camera: int


def is_colmap(path: Path) -> bool:
    """Whether a folder is, or holds, a COLMAP model."""
    return path.is_dir() and _model_in(path) is not None


def read_colmap(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras, photographs and points of a COLMAP model, or of the folder of a workspace.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : a file is malformed, a camera model cannot be undistorted, or no photograph is there.
    """
    model = _model_in(path)
    if model is None:
        raise DataError(f"{path}: expected a COLMAP model: cameras and images, .bin or .txt")
    binary = (model / "cameras.bin").is_file() and (model / "images.bin").is_file()
    lenses, listed = (_binary_model if binary else _text_model)(model)
    if not listed:
        raise DataError(f"{model}: expected at least one image in the model")
    places = (path, model, model.parent, model.parent.parent)
    usual = [place / name for name in IMAGE_FOLDERS for place in places]
    found = find_images([image.name for image in listed], [images] if images else usual, str(model))
    calibrated = []
    for image in listed:
        if image.name not in found:
            continue
        if image.camera not in lenses:
            raise DataError(f"{model}: image {image.name} has camera {image.camera}, which is not in cameras")
        lens = lenses[image.camera]
        where = f"{model}: image {image.name}"
        K, distortion = _intrinsics(lens, where)
        photograph = photograph_of(found[image.name], lens.size, stored=True)
        camera = camera_of(K, _transform(image.pose), lens.size, photograph, where, distortion)
        calibrated.append(CalibratedImage(image.name.replace("\\", "/"), photograph, camera))
    return Calibrated(
        next((part for part in reversed(path.resolve().parts) if part not in ("0", "sparse")), "colmap"),
        tuple(sorted(calibrated, key=lambda image: image.name)),
        points=_points(model, binary=binary),
        notes={"format": "COLMAP"},
    )


def _model_in(path: Path) -> Path | None:
    """Folder of the model; of several numbered ones, that whose file of images is the largest."""
    for place in _MODELS:
        folder = path / place
        if place == "sparse/0":
            numbered = [folder for folder in sorted(path.glob("sparse/*")) if folder.name.isdecimal()]
            models = [folder for folder in numbered if _is_model(folder)]
            if models:
                return max(models, key=lambda folder: max(file.stat().st_size for file in folder.glob("images.*")))
        if _is_model(folder):
            return folder
    return None


def _is_model(folder: Path) -> bool:
    return any(all((folder / f"{name}.{end}").is_file() for name in ("cameras", "images")) for end in ("bin", "txt"))


def _intrinsics(lens: _Lens, where: str) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """K and OpenCV's coefficients."""
    if lens.name not in _READ:
        raise DataError(
            f"{where}: the camera model {lens.name} cannot be undone; expected {', '.join(_READ)}. COLMAP's "
            "image_undistorter makes a PINHOLE model of it"
        )
    parameters = lens.parameters.tolist()
    if lens.name in _ONE_FOCAL:
        parameters.insert(1, parameters[0])
    fx, fy, cx, cy, *coefficients = parameters
    coefficients += [0.0] * (4 - len(coefficients) if coefficients else 0)
    return pinhole_from_corner(fx, fy, cx, cy), tuple(coefficients)


def _transform(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 4) of a quaternion (w, x, y, z) and a translation."""
    w, x, y, z = pose[:4] / np.linalg.norm(pose[:4])
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.column_stack([R, pose[4:]])


def _text_model(model: Path) -> tuple[dict[int, _Lens], list[_Image]]:
    lenses = {}
    for where, fields in _lines(model / "cameras.txt"):
        if len(fields) < 5:
            raise DataError(
                f"{where}: expected CAMERA_ID, MODEL, WIDTH, HEIGHT and parameters, got {len(fields)} fields"
            )
        key, width, height = (int(number) for number in numbers((fields[0], *fields[2:4]), 3, where))
        name = fields[1].upper()
        values = numbers(fields[4:], _READ.get(name, len(fields) - 4), where)
        lenses[key] = _Lens(name, (width, height), values)
    images: list[_Image] = []
    points_next = False
    for where, fields in _lines(model / "images.txt", blank=True):
        # Each image's line is followed by one of its 2D points, which may be empty, or left out.
        if not fields or (points_next and _is_points(fields)):
            points_next = False
            continue
        if len(fields) < 10:
            raise DataError(
                f"{where}: expected IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME, got {fields!r:.100}"
            )
        values = numbers(fields[:9], 9, where)
        images.append(_Image(" ".join(fields[9:]), values[1:8], int(values[8])))
        points_next = True
    return lenses, images


def _is_points(fields: list[str]) -> bool:
    """Whether a line is one of 2D points, X, Y and POINT3D_ID."""
    try:
        return len(fields) % 3 == 0 and bool([float(field) for field in (*fields[:3], fields[-1])])
    except ValueError:
        return False


def _lines(file: Path, *, blank: bool = False) -> Iterator[tuple[str, list[str]]]:
    """Place and fields of each line that is no comment; of blank ones where asked."""
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        for number, line in enumerate(opened, start=1):
            if not line.startswith("#") and (blank or line.strip()):
                yield f"{file}:{number}", line.split()


class _Bytes:
    """A binary file, read from its start."""

    def __init__(self, file: Path) -> None:
        self._file, self._data, self._at = file, file.read_bytes(), 0

    def take(self, form: str) -> tuple[int | float, ...]:
        """Numbers in a format of ``struct``, little-endian."""
        form = f"<{form}"
        self.skip(size := struct.calcsize(form))
        return struct.unpack_from(form, self._data, self._at - size)

    def count(self, least: int) -> int:
        """A number of items, each of so many bytes at least."""
        count = int(self.take("Q")[0])
        if count * least > len(self._data) - self._at:
            raise DataError(f"{self._file}: expected {count} items from byte {self._at} on, the file ends before")
        return count

    def name(self) -> str:
        """Text up to a zero byte."""
        end = self._data.find(b"\0", self._at)
        start, self._at = self._at, end + 1
        if end < 0:
            raise DataError(f"{self._file}: expected a name that ends, from byte {start} on")
        return self._data[start:end].decode("utf-8", "replace")

    def skip(self, size: int) -> None:
        """Go on by so many bytes."""
        self._at += size
        if self._at > len(self._data):
            raise DataError(f"{self._file}: the file ends within a record, at byte {len(self._data)}")


def _binary_model(model: Path) -> tuple[dict[int, _Lens], list[_Image]]:
    file, lenses = _Bytes(model / "cameras.bin"), {}
    for _ in range(file.count(24)):
        key, number, width, height = (int(value) for value in file.take("IiQQ"))
        if number not in _BY_ID:  # how many parameters follow is not known
            raise DataError(
                f"{model / 'cameras.bin'}: the camera model {number} cannot be undone; expected {', '.join(_READ)}. "
                "COLMAP's image_undistorter makes a PINHOLE model of it"
            )
        name, count = _BY_ID[number]
        lenses[key] = _Lens(name, (width, height), np.array(file.take(f"{count}d")))
    file, images = _Bytes(model / "images.bin"), []
    for _ in range(file.count(73)):
        _, *pose, camera = file.take("I7dI")
        images.append(_Image(file.name(), np.array(pose), int(camera)))
        file.skip(24 * file.count(24))
    return lenses, images


def _points(model: Path, *, binary: bool) -> NDArray[np.float64] | None:
    """(n, 3) points, world; None where there is no file of them."""
    path = model / f"points3D.{'bin' if binary else 'txt'}"
    if not path.is_file():
        return None
    if not binary:
        rows = list(_lines(path))
        try:
            return np.array([fields[1:4] for _, fields in rows], np.float64).reshape(-1, 3)
        except ValueError:
            return np.array([numbers(fields[1:4], 3, where) for where, fields in rows])  # names the line
    file, points = _Bytes(path), []
    for _ in range(file.count(51)):
        points.append(file.take("Q3d3Bd")[1:4])
        file.skip(8 * file.count(8))
    return np.array(points, np.float64).reshape(-1, 3)
