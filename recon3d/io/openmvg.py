"""OpenMVG's ``sfm_data.json``: views, intrinsics, extrinsics and the structure.

``rotation`` is world to camera with x right, y down, z forward, and ``center`` is the camera's: t = -R C. Pixel centres
are at integers, as OpenMVG's features count them, and its radial (k1, k2, k3) and Brown's (k1, k2, k3, t1, t2)
distortion are OpenCV's. What lens it is follows from the names of the coefficients: cereal, which writes the file,
names a type at its first use only.

References
----------
Moulon, Monasse, Perrot, Marlet, "OpenMVG: Open Multiple View Geometry", RRPR 2016;
https://openmvg.readthedocs.io/en/latest/openMVG/sfm/sfm/
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

_FOLDERS = ("", "reconstruction_sequential", "reconstruction_global", "reconstruction", "matches", "sfm")
_HEAD = 4096
_COEFFICIENTS = {"disto_k1": 1, "disto_k3": 3, "disto_t2": 5}
"""Of the lenses that OpenCV undoes, and how many there are."""


def is_openmvg(path: Path) -> bool:
    """Whether a folder holds OpenMVG's JSON, or a file is such."""
    return bool(_files(path))


def read_openmvg(path: Path, images: Path | None = None) -> Calibrated:
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
        raise DataError(f"{path}: expected OpenMVG's sfm_data.json")
    contents = {file: read_json(file) for file in files}
    file = next((file for file, content in contents.items() if content.get("extrinsics")), None)
    if file is None:
        raise DataError(
            f"{files[0]}: expected extrinsics, got none: this was written before the reconstruction; its result holds "
            "poses, and openMVG_main_ConvertSfM_DataFormat makes JSON of sfm_data.bin"
        )
    content = contents[file]
    views, lenses, poses = (_by_key(content, part, file) for part in ("views", "intrinsics", "extrinsics"))
    taken = {}
    left_out = []
    for key, view in views.items():
        name = "/".join(part for part in (str(view.get("local_path", "")), str(view.get("filename", ""))) if part)
        if str(view.get("id_pose")) in poses and str(view.get("id_intrinsic")) in lenses:
            taken[name] = key
        else:
            left_out.append(name)
    if not taken:
        raise DataError(f"{file}: expected a view whose pose and intrinsics are there, got none")
    root = str(content.get("root_path", ""))
    places = [images] if images else [*_places(file), *([Path(root)] if root and Path(root).is_absolute() else [])]
    calibrated = {}
    for name, image in find_images(list(taken), places, str(file)).items():
        view, where = views[taken[name]], f"{file}: view {taken[name]} ({name})"
        calibrated[image] = _image(image, lenses[str(view["id_intrinsic"])], poses[str(view["id_pose"])], where)
    notes = {"format": f"OpenMVG ({file.name})"}
    if left_out:
        notes["left out"] = f"{len(left_out)} views without a pose: {listed(left_out)}"
    structure = _by_key(content, "structure", file) if content.get("structure") else {}
    points = [numbers((point.get("X"),), 3, f"{file}: point {key}") for key, point in structure.items()]
    return Calibrated(
        _scene(file).resolve().name, views_named(calibrated), points=np.array(points) if points else None, notes=notes
    )


def _files(path: Path) -> list[Path]:
    """JSON files of OpenMVG's, those of a finished reconstruction first."""
    if path.is_file():
        return [path] if _is_openmvg(path) else []
    files = [file for name in _FOLDERS for file in sorted((path / name).glob("*.json")) if _is_openmvg(file)]
    return sorted(files, key=lambda file: file.parent.name == "matches")


def _is_openmvg(file: Path) -> bool:
    if file.suffix.lower() != ".json":
        return False
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        return '"sfm_data_version"' in opened.read(_HEAD)


def _scene(file: Path) -> Path:
    return file.parent.parent if file.parent.name in _FOLDERS else file.parent


def _places(file: Path) -> list[Path]:
    return [place / name for place in (file.parent, _scene(file)) for name in IMAGE_FOLDERS]


def _by_key(content: Mapping[str, Any], part: str, file: Path) -> dict[str, Mapping[str, Any]]:
    """Values of a map as cereal writes it, by their keys; of a shared pointer what it points to."""
    found: dict[str, Mapping[str, Any]] = {}
    for n, entry in enumerate(entries(content, part, str(file))):
        value: Any = entry.get("value")
        for step in ("ptr_wrapper", "data"):
            value = value.get(step, value) if isinstance(value, dict) else value
        if not isinstance(value, dict) or "key" not in entry:
            raise DataError(f"{file}: {part} {n}: expected a key and a value")
        found[str(entry["key"])] = value
    return found


def _image(path: Path, lens: Mapping[str, Any], pose: Mapping[str, Any], where: str) -> CalibratedImage:
    K, size, distortion = _intrinsics(lens, where)
    R = numbers((pose.get("rotation"),), 9, f"{where}: rotation").reshape(3, 3)
    center = numbers((pose.get("center"),), 3, f"{where}: center")
    photograph = photograph_of(path, size, stored=True)
    camera = camera_of(K, np.column_stack([R, -R @ center]), size, photograph, where, distortion)
    return CalibratedImage("", photograph, camera)


def _intrinsics(
    lens: Mapping[str, Any], where: str
) -> tuple[NDArray[np.float64], tuple[int, int], NDArray[np.float64]]:
    """K, width and height, and OpenCV's coefficients."""
    base = lens.get("value0")
    base = base if isinstance(base, dict) else lens  # derived classes hold what they share in it
    named = [name for name in lens if name not in ("value0", "width", "height", "focal_length", "principal_point")]
    unknown = [name for name in named if name not in _COEFFICIENTS]
    if unknown or "focal_length" not in base:
        raise DataError(
            f"{where}: a lens with {', '.join(unknown) or 'no focal_length'} cannot be undone, expected a pinhole, its "
            "radial distortion (disto_k1, disto_k3) or Brown's (disto_t2); openMVG_main_ExportUndistortedImages makes "
            "pinhole photographs"
        )
    size = whole(base.get("width"), f"{where}: width"), whole(base.get("height"), f"{where}: height")
    focal = numbers((base["focal_length"],), (1, 2), f"{where}: focal_length")
    cx, cy = numbers((base.get("principal_point"),), 2, f"{where}: principal_point")
    k = [numbers((lens[name],), _COEFFICIENTS[name], f"{where}: {name}") for name in named]
    k1, k2, k3, t1, t2 = np.append(k[0] if k else (), np.zeros(5))[:5]
    return pinhole(focal[0], focal[-1], cx, cy), size, np.array([k1, k2, t1, t2, k3])
