"""Agisoft Metashape's cameras (File, Export, Export Cameras, Agisoft XML): ``cameras.xml`` beside the photographs.

A camera's ``transform`` is camera to chunk with x right, y down, z forward, as in recon3d; the chunk's own scale,
rotation and translation take it to the world. cx and cy are measured from the image's middle and pixels from its
corner, the upper left pixel's centre being (½, ½). f + b1 and f are the focal lengths, b2 the skew. P1 and P2 are
OpenCV's p2 and p1.

References
----------
Agisoft Metashape User Manual, appendix "Camera models".
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.parsing import numbers, read_xml
from recon3d.io.photographs import IMAGE_FOLDERS, camera_of, find_images, listed, photograph_of, pinhole_from_corner
from recon3d.scene.bounds import Bounds

_HEAD = 2000  # characters in which a file says what it is
_CANNOT = ("k4", "p3", "p4")


class _Sensor(NamedTuple):
    """Calibration of a camera's sensor."""

    size: tuple[int, int]
    K: NDArray[np.float64]
    distortion: tuple[float, ...]


class _Frame(NamedTuple):
    """A chunk's or component's place in the world, X = scale R x + t, and its region."""

    scale: float
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    bounds: Bounds | None


def is_metashape(path: Path) -> bool:
    """Whether a folder holds Metashape's cameras, or a file does."""
    return _file(path) is not None


def read_metashape(path: Path, images: Path | None = None) -> Calibrated:
    """Aligned cameras of the first chunk that has some, their photographs, and its region as bounds.

    Parameters
    ----------
    images : folder of the photographs, where they lie elsewhere.

    Raises
    ------
    DataError : the file is malformed, a lens cannot be undistorted, or no photograph is there.
    """
    file = _file(path)
    if file is None:
        raise DataError(f"{path}: expected cameras exported by Metashape, *.xml")
    root = read_xml(file)
    chunks = [root] if root.tag == "chunk" else list(root.iter("chunk"))
    chunk = next((chunk for chunk in chunks if any(_aligned(camera) for camera in chunk.iter("camera"))), None)
    if chunk is None:
        raise DataError(f"{file}: expected a chunk with aligned cameras, found none")
    cameras = list(chunk.iter("camera"))
    aligned = {camera.get("label", ""): camera for camera in cameras if _aligned(camera)}
    if len(aligned) < sum(map(_aligned, cameras)):
        raise DataError(f"{file}: expected labels that differ; two cameras share one")
    left_out = [camera.get("label", "") for camera in cameras if not _aligned(camera)]
    places = [file.parent / name for name in IMAGE_FOLDERS] + [file.parent.parent / name for name in IMAGE_FOLDERS[:-1]]
    found = find_images(list(aligned), [images] if images else places, str(file))
    frames = {
        part.get("id"): _frame(part, str(file))
        for part in chunk.iter("component")
        if part.find("transform") is not None
    }
    whole = _frame(chunk, str(file))
    sensors: dict[str, _Sensor] = {}
    calibrated, used = [], []
    for label, image in found.items():
        camera, where = aligned[label], f"{file}: camera {label}"
        key = camera.get("sensor_id", "")
        if key not in sensors:
            sensors[key] = _sensor(chunk, key, where)
        frame = frames.get(camera.get("component_id"), whole)
        used.append(frame)
        calibrated.append(_image(camera, image, sensors[key], frame, where))
    scaled = whole.scale != 1 or chunk.find("transform") is not None
    notes = {"format": "Metashape XML"}
    if left_out:
        notes["left out"] = f"{len(left_out)} cameras that are not aligned or not enabled: {listed(left_out)}"
    return Calibrated(
        file.parent.resolve().name,
        tuple(sorted(calibrated, key=lambda image: image.name)),
        bounds=next((frame.bounds for frame in used if frame.bounds), whole.bounds),
        mm_per_unit=1000.0 if scaled else None,
        notes=notes,
    )


def _image(camera: Element, path: Path, sensor: _Sensor, frame: _Frame, where: str) -> CalibratedImage:
    photograph = photograph_of(path, sensor.size, stored=True)
    pose = numbers(_text(camera, "transform").split(), 16, f"{where}: transform").reshape(4, 4)
    R, center = frame.R @ pose[:3, :3], frame.scale * frame.R @ pose[:3, 3] + frame.t
    cam_from_world = np.column_stack([R.T, -R.T @ center])
    taken_by = camera_of(sensor.K, cam_from_world, sensor.size, photograph, where, sensor.distortion)
    return CalibratedImage(path.name, photograph, taken_by)


def _file(path: Path) -> Path | None:
    """The folder's XML file that is Metashape's."""
    files = [path] if path.is_file() else sorted(path.glob("*.xml"))
    return next((file for file in files if file.suffix.lower() == ".xml" and _is_metashape(file)), None)


def _is_metashape(file: Path) -> bool:
    with file.open(encoding="utf-8-sig", errors="replace") as opened:
        head = opened.read(_HEAD)
    return "<chunk" in head and ("<document" in head or head.lstrip().startswith("<chunk"))


def _aligned(camera: Element) -> bool:
    """Whether a camera has a pose and is in use."""
    return camera.find("transform") is not None and camera.get("enabled", "true").lower() in ("true", "1")


def _text(element: Element, name: str) -> str:
    return element.findtext(name) or ""


def _sensor(chunk: Element, key: str, where: str) -> _Sensor:
    """Adjusted calibration of a sensor, or else the one that there is."""
    sensor = next((sensor for sensor in chunk.iter("sensor") if sensor.get("id") == key), None)
    if sensor is None:
        raise DataError(f"{where}: expected a sensor {key!r}, it is not in the file")
    kind = sensor.get("type", "frame")
    calibrations = sorted(_calibrations(sensor), key=lambda found: found.get("class") != "adjusted")
    if kind != "frame" or any(found.get("type", "frame") != "frame" for found in calibrations[:1]):
        raise DataError(
            f"{where}: a {kind} camera cannot be undone, expected type frame; export undistorted photographs from "
            "Metashape"
        )
    if not calibrations:
        raise DataError(f"{where}: expected a calibration of sensor {key}, it has none; align the cameras first")
    calibration = calibrations[0]
    resolution = calibration.find("resolution")
    if resolution is None:
        resolution = sensor.find("resolution")
    if resolution is None:
        raise DataError(f"{where}: expected the resolution of sensor {key}")
    width, height = numbers((resolution.get("width"), resolution.get("height")), 2, f"{where}: resolution")

    def value(name: str) -> float:
        return float(numbers((calibration.findtext(name) or 0.0,), 1, f"{where}: calibration, {name}")[0])

    cannot = [name for name in _CANNOT if value(name)]
    if cannot:
        raise DataError(
            f"{where}: the distortion {', '.join(cannot)} cannot be undone, expected k1, k2, k3, p1, p2 alone; fix it "
            "to 0 in Metashape, or export undistorted photographs"
        )
    f = value("f")
    if f:
        K = pinhole_from_corner(f + value("b1"), f, width / 2 + value("cx"), height / 2 + value("cy"), value("b2"))
    else:  # PhotoScan
        K = pinhole_from_corner(value("fx"), value("fy"), value("cx"), value("cy"), value("skew"))
    distortion = (value("k1"), value("k2"), value("p2"), value("p1"), value("k3"))
    return _Sensor((int(width), int(height)), K, distortion)


def _calibrations(sensor: Element) -> Iterator[Element]:
    return sensor.iter("calibration")


def _frame(part: Element, where: str) -> _Frame:
    """Place and region of a chunk or a component."""
    scale, R, t = 1.0, np.eye(3), np.zeros(3)
    transform = part.find("transform")
    if transform is not None and len(transform):
        where = f"{where}: transform of the chunk"
        if transform.find("rotation") is not None:
            R = numbers(_text(transform, "rotation").split(), 9, where).reshape(3, 3)
        if transform.find("translation") is not None:
            t = numbers(_text(transform, "translation").split(), 3, where)
        if transform.find("scale") is not None:
            scale = float(numbers(_text(transform, "scale").split(), 1, where)[0])
        if scale <= 0:
            raise DataError(f"{where}: expected a scale above 0, got {scale:g}")
    elif transform is not None and _text(part, "transform").strip():
        matrix = numbers(_text(part, "transform").split(), 16, f"{where}: transform of the chunk").reshape(4, 4)
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        R, t = matrix[:3, :3] / scale, matrix[:3, 3]
    region, bounds = part.find("region"), None
    if region is not None:
        center = numbers(_text(region, "center").split(), 3, f"{where}: center of the region")
        size = numbers(_text(region, "size").split(), 3, f"{where}: size of the region")
        axes = numbers((_text(region, "R") or "1 0 0 0 1 0 0 0 1").split(), 9, f"{where}: R of the region").reshape(
            3, 3
        )
        corners = center + Bounds(-size / 2, size / 2).corners @ axes.T
        corners = scale * corners @ R.T + t
        bounds = Bounds(corners.min(axis=0), corners.max(axis=0))
    return _Frame(scale, R, t, bounds)
