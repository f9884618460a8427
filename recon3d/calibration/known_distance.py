"""Scale from a distance that was measured between two points of the photographs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.calibration.result import CalibratedCamera, Calibration, transformed
from recon3d.errors import ArgumentError
from recon3d.scene.similarity import Similarity

_FORM = "IMAGE:U,V+IMAGE:U,V IMAGE:U,V+IMAGE:U,V = 120mm"
_PLACE = r"[^\s=]+?:[\d.]+,[\d.]+"
_MAX_RESIDUAL = 5.0  # pixels: more is no one point
_NEIGHBOURS = 8  # points around a pixel that its depth is taken from


@dataclass(frozen=True)
class KnownDistance:
    """Two points and the millimetres between them."""

    ends: tuple[Mapping[str, tuple[float, float]], Mapping[str, tuple[float, float]]]
    """Of each point the pixel (u, v) in every photograph that it was looked up in, by the photograph's name; upright,
    not undistorted, pixel centres at integers."""
    mm: float

    @classmethod
    def parse(cls, text: str) -> KnownDistance:
        """The distance of a text like ``a.jpg:812,400+b.jpg:790,405 a.jpg:210,410+b.jpg:190,420 = 120mm``.

        Raises
        ------
        ArgumentError : another text.
        """
        end = rf"({_PLACE}(?:\+{_PLACE})*)"
        found = re.fullmatch(rf"\s*{end}\s+{end}\s*=\s*(\d+(?:\.\d+)?)\s*mm\s*", text)
        if not found or float(found[3]) <= 0:
            raise ArgumentError(f"expected a distance like {_FORM}, got {text!r}")
        ends = []
        for part in found.group(1, 2):
            places = re.findall(r"([^+:][^:]*):([\d.]+),([\d.]+)(?:\+|$)", part)
            try:
                ends.append({name: (float(u), float(v)) for name, u, v in places})
            except ValueError:
                raise ArgumentError(f"expected a distance like {_FORM}, got {text!r}") from None
        return cls((ends[0], ends[1]), float(found[3]))


def with_known_distance(calibration: Calibration, distance: KnownDistance) -> Calibration:
    """The calibration in metres, so that two points lie as far apart as they were measured.

    A point that was looked up in several photographs is triangulated, and all the more exact the farther apart these
    are; of one that was looked up in one photograph the depth is that of the calibration's points around it.

    Raises
    ------
    ArgumentError : a photograph has no camera, the rays of a point do not meet, or both points are one.
    """
    a, b = (_place(calibration, end) for end in distance.ends)
    units = float(np.linalg.norm(a - b))
    if units < 1e-9:
        raise ArgumentError("expected two different points of a known distance, got one place")
    metres = Similarity(distance.mm / 1000 / units, np.eye(3), np.zeros(3))
    return transformed(calibration, metres, mm_per_unit=1000.0)


def _place(calibration: Calibration, pixels: Mapping[str, tuple[float, float]]) -> NDArray[np.float64]:
    """(3,) world point of its pixels."""
    by_name = {camera.name: camera for camera in calibration.cameras}
    for name, (u, v) in pixels.items():
        if name not in by_name:
            why = calibration.unplaced.get(name, f"there are {', '.join(list(by_name)[:3])} and so on")
            raise ArgumentError(f"known distance: the photograph {name} has no camera: {why}")
        camera = by_name[name]
        if not (0 <= u < camera.width and 0 <= v < camera.height):
            raise ArgumentError(f"known distance: {name} has {camera.width}x{camera.height} pixels, got {u:g},{v:g}")
    cameras, places = [by_name[name] for name in pixels], np.array(list(pixels.values()), np.float64)
    if len(cameras) == 1:
        return _on_ray(calibration, cameras[0], places[0])
    point = _triangulated(cameras, places)
    apart = [np.linalg.norm(camera.project(point[None])[0] - uv) for camera, uv in zip(cameras, places, strict=True)]
    if max(apart) > _MAX_RESIDUAL:
        worst = int(np.argmax(apart))
        raise ArgumentError(
            f"known distance: the pixels of a point in {', '.join(pixels)} are not of one place: "
            f"{max(apart):.1f} pixels apart in {cameras[worst].name}"
        )
    return point


def _triangulated(cameras: Sequence[CalibratedCamera], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) point by the homogeneous linear system of its pixels (n, 2)."""
    rows = []
    for camera, pixel in zip(cameras, pixels, strict=True):
        x, y = cv2.undistortPoints(pixel[None, None], camera.K, camera.distortion).ravel()
        P = camera.cam_from_world[:3]
        rows += [x * P[2] - P[0], y * P[2] - P[1]]
    point = np.linalg.svd(np.array(rows))[2][-1]
    return np.asarray(point[:3] / point[3])


def _on_ray(calibration: Calibration, camera: CalibratedCamera, pixel: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) point of a pixel, in the plane of the points that are seen next to it."""
    seen = calibration.observations
    mine = seen.views == calibration.cameras.index(camera)
    if np.count_nonzero(mine) < _NEIGHBOURS:
        raise ArgumentError(f"known distance: {camera.name} shows too few points to tell a depth; give a second image")
    nearest = np.argsort(np.linalg.norm(seen.pixels[mine] - pixel, axis=1))[:_NEIGHBOURS]
    points = calibration.points[seen.points[mine][nearest]]
    in_camera = points @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]
    x, y = cv2.undistortPoints(pixel[None, None], camera.K, camera.distortion).ravel()
    # One over the depth is linear in the image of a plane.
    system = np.column_stack([in_camera[:, :2] / in_camera[:, 2:], np.ones(len(points))])
    inverse = np.linalg.lstsq(system, 1 / in_camera[:, 2], rcond=1e-3)[0] @ [x, y, 1]
    depth = 1 / np.clip(inverse, 1 / in_camera[:, 2].max(), 1 / in_camera[:, 2].min())
    back = np.array([x, y, 1]) * depth - camera.cam_from_world[:3, 3]
    return np.asarray(camera.cam_from_world[:3, :3].T @ back)
