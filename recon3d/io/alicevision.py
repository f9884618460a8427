"""AliceVision's JSON, as Meshroom keeps it: ``cameras.sfm``, ``sfm.json``, with numbers as text.

``rotation`` is world to camera, by columns, with x right, y down, z forward, and ``center`` is the camera's: t = -R C.
Pixel centres are at integers, as AliceVision samples its images. Since version 1.2.1 the principal point is measured
from the image's middle; since 1.2.2 the focal length is in millimetres of the sensor, and fy = fx / ``pixelRatio``
before 1.2.5, fx * ``pixelRatio`` from there on. The radial (k1, k2, k3) and Brown's (k1, k2, k3, t1, t2) distortion are
OpenCV's.

References
----------
Griwodz, Gasparini, Calvet, Gurdjos, Castan, Maujean, De Lillo, Lanthony, "AliceVision Meshroom: An open-source 3D
reconstruction pipeline", MMSys 2021.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import entries, numbers, read_json, whole
from recon3d.io.photographs import IMAGE_FOLDERS, camera_of, find_images, listed, photograph_of, pinhole, views_named

_HEAD = 2**20
_MARKS = ('"viewId"', '"intrinsicId"')
_PINHOLES = {"pinhole": 0, "radial1": 1, "radial3": 3, "brown": 5}
"""Lenses that OpenCV undoes, and their numbers of coefficients; before 1.2.6 or so the type tells the distortion."""
_DISTORTIONS = {"none": 0, "radialk1": 1, "radialk3": 3, "brown": 5}


def is_alicevision(path: Path) -> bool:
    """Whether a folder holds AliceVision's JSON, or a file is such."""
    return bool(_files(path))


def read_alicevision(path: Path, images: Path | None = None) -> Calibrated:
    """Views that have a pose, their photographs and the points.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : the file is malformed, has no poses, a lens cannot be undistorted, or no photograph is there.
    """
    files = _files(path)
    if not files:
        raise DataError(f"{path}: expected AliceVision's cameras.sfm or sfm.json")
    contents = {file: read_json(file) for file in files}
    file = next((file for file, content in contents.items() if content.get("poses")), None)
    if file is None:
        raise DataError(
            f"{files[0]}: expected poses, got none: this was written before the reconstruction; take cameras.sfm of "
            "Meshroom's node StructureFromMotion"
        )
    content = contents[file]
    version = tuple(int(n) for n in numbers((content.get("version", (1, 0, 0)),), 3, f"{file}: version"))
    lenses, poses = (
        _by(content, part, key, file) for part, key in (("intrinsics", "intrinsicId"), ("poses", "poseId"))
    )
    if content.get("rigs"):
        raise DataError(f"{file}: the poses of a rig's cameras are not read; calibrate the photographs without the rig")
    views, left_out = {}, []
    for n, view in enumerate(entries(content, "views", str(file))):
        name = str(view.get("path", ""))
        if not name:
            raise DataError(f"{file}: view {n}: expected a path")
        if str(view.get("poseId")) in poses and str(view.get("intrinsicId")) in lenses:
            views[name] = view
        else:
            left_out.append(name)
    if not views:
        raise DataError(f"{file}: expected a view whose pose and intrinsics are there, got none")
    places = [place / name for place in (file.parent, file.parent.parent) for name in IMAGE_FOLDERS]
    places += [Path(name).parent for name in views if Path(name).is_absolute()][:1]
    places = [images] if images else places
    calibrated = {}
    for name, image in find_images(list(views), places, str(file)).items():
        view, where = views[name], f"{file}: view {name}"
        calibrated[image] = _image(image, lenses[str(view["intrinsicId"])], poses[str(view["poseId"])], version, where)
    notes = {"format": f"AliceVision ({file.name})"}
    if left_out:
        notes["left out"] = f"{len(left_out)} views without a pose: {listed(left_out)}"
    structure = entries(content, "structure", str(file)) if content.get("structure") else []
    points = [numbers((point.get("X"),), 3, f"{file}: point {n}") for n, point in enumerate(structure)]
    return Calibrated(
        file.parent.resolve().name, views_named(calibrated), points=np.array(points) if points else None, notes=notes
    )


def _files(path: Path) -> list[Path]:
    files = [path] if path.is_file() else [*sorted(path.glob("*.sfm")), *sorted(path.glob("*.json"))]
    return [file for file in files if _is_alicevision(file)]


def _is_alicevision(file: Path) -> bool:
    if file.suffix.lower() not in (".sfm", ".json"):
        return False
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        head = opened.read(_HEAD)
    return all(mark in head for mark in _MARKS)


def _by(content: Mapping[str, Any], part: str, key: str, file: Path) -> dict[str, Mapping[str, Any]]:
    return {str(entry.get(key)): entry for entry in entries(content, part, str(file))}


def _image(
    path: Path, lens: Mapping[str, Any], pose: Mapping[str, Any], version: tuple[int, ...], where: str
) -> CalibratedImage:
    K, size, distortion = _intrinsics(lens, version, where)
    transform: Any = pose.get("pose")
    transform = transform.get("transform") if isinstance(transform, dict) else None
    if not isinstance(transform, dict):
        raise DataError(f"{where}: expected a pose with a transform")
    R = numbers((transform.get("rotation"),), 9, f"{where}: rotation").reshape(3, 3).T
    center = numbers((transform.get("center"),), 3, f"{where}: center")
    photograph = photograph_of(path, size, stored=True)
    camera = camera_of(K, np.column_stack([R, -R @ center]), size, photograph, where, distortion)
    return CalibratedImage("", photograph, camera)


def _intrinsics(
    lens: Mapping[str, Any], version: tuple[int, ...], where: str
) -> tuple[NDArray[np.float64], tuple[int, int], NDArray[np.float64]]:
    """K, width and height, and OpenCV's coefficients."""
    width, height = (whole(lens.get(side), f"{where}: {side}") for side in ("width", "height"))
    kind = str(lens.get("type", ""))
    distortion = str(lens.get("distortionType", "none"))
    count = max(_PINHOLES.get(kind, -1), _DISTORTIONS.get(distortion, -1))
    known = kind in _PINHOLES and distortion in _DISTORTIONS
    if not known or lens.get("undistortionType", "none") != "none":
        raise DataError(
            f"{where}: the lens {kind} {distortion} cannot be undone, expected {', '.join(_PINHOLES)}; Meshroom's node "
            "PrepareDenseScene, or ExportImages, undistorts the photographs"
        )

    def value(name: str, otherwise: float) -> float:
        return float(numbers((lens.get(name, otherwise),), 1, f"{where}: {name}")[0])

    if version < (1, 2, 2):
        focal = numbers((lens.get("pxFocalLength"),), (1, 2), f"{where}: pxFocalLength")
        fx, fy = float(focal[0]), float(focal[-1])
    else:
        sensor, ratio = value("sensorWidth", 36.0), value("pixelRatio", 1.0)
        if min(sensor, ratio) <= 0:
            raise DataError(f"{where}: expected sensorWidth and pixelRatio above 0, got {sensor:g} and {ratio:g}")
        fx = value("focalLength", 0.0) / sensor * width
        fy = fx / ratio if version < (1, 2, 5) else fx * ratio
    cx, cy = numbers((lens.get("principalPoint"),), 2, f"{where}: principalPoint")
    if version >= (1, 2, 1):
        cx, cy = cx + width / 2, cy + height / 2
    given = lens.get("distortionParams") or ()
    k = numbers(given if isinstance(given, list) else (), (0, count), f"{where}: distortionParams")
    k1, k2, k3, t1, t2 = np.append(k, np.zeros(5))[:5]
    return pinhole(fx, fy, cx, cy), (width, height), np.array([k1, k2, t1, t2, k3])
