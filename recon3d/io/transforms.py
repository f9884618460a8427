"""``transforms.json`` of nerfstudio, instant-ngp and Blender's synthetic scenes.

The poses are camera to world with OpenGL's axes, x right, y up, looking along -z: y and z are turned over.
Pixels are counted from the image's corner, as in COLMAP, where most of these files come from: the upper left pixel's
centre is (½, ½), and half a pixel is taken off cx and cy. What ``applied_transform`` and ``applied_scale`` say was done
to the world is undone, so that it is that of the model which the file was made from.

References
----------
https://docs.nerf.studio/quickstart/data_conventions.html
https://github.com/NVlabs/instant-ngp/blob/master/docs/nerf_dataset_tips.md
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_json
from recon3d.io.photographs import (
    camera_of,
    find_image,
    photograph_of,
    pinhole_from_corner,
    views_named,
    warn_of_missing,
)

_NAME = "transforms.json"
_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_LENSES = ("", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_ORDER = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's
_OTHER = ("k4", "k5", "k6")  # not OpenCV's polynomial
_UNIFORM = 1e-3  # by which the lengths of a pose's axes may differ


def is_transforms(path: Path) -> bool:
    """Whether a folder holds a ``transforms*.json``, or a file is one."""
    return bool(_files(path))


def read_transforms(path: Path) -> Calibrated:
    """Cameras and photographs of a ``transforms.json``, or of ``transforms_train.json`` and the other splits' files.

    Raises
    ------
    DataError : a file is malformed, a lens cannot be undistorted, or no photograph is there.
    """
    files = _files(path)
    images: dict[Path, CalibratedImage] = {}
    listed = 0
    for file in files:
        content = read_json(file)
        frames = content.get("frames")
        if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
            raise DataError(f"{file}: expected a list 'frames' of objects")
        missing = []
        world = _world(content, str(file))
        for number, frame in enumerate(frames):
            where = f"{file}: frame {number}"
            name = str(frame.get("file_path", ""))
            if not name:
                raise DataError(f"{where}: expected a file_path")
            found = find_image(file.parent, name) or find_image(file.parent / "images", name)
            if found is None:
                missing.append(name)
            elif found not in images:
                image = _image(found, {**content, **frame}, world, f"{where} ({name})")
                mask = frame.get("mask_path")
                images[found] = image._replace(mask=_mask(file.parent, mask, where) if mask else None)
        listed += len(frames)
        warn_of_missing(missing, str(file))
    if not images:
        raise DataError(f"{files[0]}: none of its {listed} photographs is there")
    names = ", ".join(file.name for file in files)
    return Calibrated(files[0].parent.resolve().name, views_named(images), notes={"format": f"{names} (NeRF)"})


def _files(path: Path) -> list[Path]:
    """``transforms.json``, or those of the splits."""
    if path.is_file():
        return [path] if path.suffix.lower() == ".json" and "transforms" in path.name.lower() else []
    files = [path / _NAME] if (path / _NAME).is_file() else sorted(path.glob("transforms*.json"))
    return sorted(files, key=lambda file: "train" not in file.name)


def _image(path: Path, values: Mapping[str, Any], world: NDArray[np.float64], where: str) -> CalibratedImage:
    """Camera and photograph of a frame, whose own values come before those of the file."""
    size = _size(values, where)
    photograph = photograph_of(path, size, stored=False)
    K, distortion = _intrinsics(values, size or photograph.size, where)
    pose = world @ _pose(values.get("transform_matrix"), where) @ _FROM_OPENGL
    pose[:3, :3] /= np.cbrt(abs(np.linalg.det(pose[:3, :3])))
    camera = camera_of(K, np.linalg.inv(pose), size, photograph, where, distortion)
    return CalibratedImage("", photograph, camera)


def _mask(folder: Path, name: object, where: str) -> Path:
    found = find_image(folder, str(name))
    if found is None:
        raise DataError(f"{where}: its mask {name} is not there")
    return found


def _size(values: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    """Width and height that were calibrated, where the file says."""
    if not (values.get("w") and values.get("h")):
        return None
    width, height = numbers((values["w"], values["h"]), 2, where)
    return int(width), int(height)


def _intrinsics(
    values: Mapping[str, Any], size: tuple[int, int], where: str
) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """K and OpenCV's coefficients."""
    width, height = size
    lens = str(values.get("camera_model", "")).upper()
    if lens not in _LENSES or values.get("is_fisheye"):
        raise DataError(
            f"{where}: the camera model {lens if lens not in _LENSES else 'fisheye'} cannot be undone; expected "
            f"{', '.join(_LENSES[1:])}. Undistort the photographs first"
        )

    def value(key: str) -> float:
        return float(numbers((values.get(key) or 0.0,), 1, f"{where}, {key}")[0])

    def focal(axis: str, side: int) -> float:
        angle = value(f"camera_angle_{axis}") or np.radians(value(f"{axis}_fov"))
        return value(f"fl_{axis}") or (side / 2 / np.tan(angle / 2) if 0 < angle < np.pi else 0.0)

    fx, fy = focal("x", width), focal("y", height)
    if not (fx or fy):
        raise DataError(f"{where}: expected fl_x, or camera_angle_x in radians between 0 and pi")
    cx, cy = (value(key) if key in values else side / 2 for key, side in (("cx", width), ("cy", height)))
    further = [key for key in _OTHER if value(key)]
    if further:
        raise DataError(f"{where}: the distortion {', '.join(further)} cannot be undone; expected {', '.join(_ORDER)}")
    return pinhole_from_corner(fx or fy, fy or fx, cx, cy), tuple(map(value, _ORDER))


def _pose(matrix: object, where: str) -> NDArray[np.float64]:
    """(4, 4) camera to world, OpenGL's axes; may hold a scale, as of a scaled camera in Blender."""
    entries = numbers(matrix if isinstance(matrix, list) else (), (12, 16), f"{where}, transform_matrix")
    pose = np.eye(4)
    pose[: len(entries) // 4] = entries.reshape(-1, 4)
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    if not lengths.min() > 0 or lengths.max() / lengths.min() - 1 > _UNIFORM:
        raise DataError(f"{where}: expected a rotation in transform_matrix, got axes of lengths {lengths.round(6)}")
    return pose


def _world(content: Mapping[str, Any], where: str) -> NDArray[np.float64]:
    """(4, 4) from the file's world to that before ``applied_transform`` and ``applied_scale``."""
    applied = np.eye(4)
    if content.get("applied_transform") is not None:
        entries = numbers(content["applied_transform"], (12, 16), f"{where}: applied_transform")
        applied[: len(entries) // 4] = entries.reshape(-1, 4)
    if content.get("applied_scale"):
        applied[:3] *= numbers((content["applied_scale"],), 1, f"{where}: applied_scale")
    if abs(np.linalg.det(applied)) < 1e-12:
        raise DataError(f"{where}: expected an applied_transform that can be undone")
    return np.asarray(np.linalg.inv(applied))
