"""What a calibration finds: a camera for each photograph, and the points that they were found by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.similarity import Similarity
from recon3d.summary import Summarised


@dataclass(frozen=True)
class CalibratedCamera:
    """The camera of one upright photograph."""

    name: str
    """The photograph's file name."""
    path: Path
    """Where the photograph lies."""
    width: int
    height: int
    K: NDArray[np.float64]
    """(3, 3) intrinsic matrix, pixels, pixel centres at integers."""
    distortion: NDArray[np.float64]
    """(5,) OpenCV's coefficients k1, k2, p1, p2, k3; zero: none."""
    cam_from_world: NDArray[np.float64]
    """(4, 4) rigid transform, OpenCV's axes."""

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) camera centre in the world."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (n, 2) as (u, v) of world points (n, 3), distorted as in the photograph."""
        if len(points) == 0:
            return np.zeros((0, 2))
        rotation = cv2.Rodrigues(self.cam_from_world[:3, :3])[0]
        pixels, _ = cv2.projectPoints(
            np.ascontiguousarray(points, np.float64), rotation, self.cam_from_world[:3, 3], self.K, self.distortion
        )
        return np.asarray(pixels.reshape(-1, 2), np.float64)


@dataclass(frozen=True)
class Observations:
    """Where the photographs show the points."""

    views: NDArray[np.int64]
    """(n,) index of the camera."""
    points: NDArray[np.int64]
    """(n,) index of the point."""
    pixels: NDArray[np.float64]
    """(n, 2) as (u, v) in the upright photograph, pixel centres at integers."""


@dataclass(frozen=True, repr=False)
class Calibration(Summarised):
    """Cameras of photographs, the points that they were found by, and the photographs without a camera."""

    cameras: tuple[CalibratedCamera, ...]
    """In the order of their names."""
    points: NDArray[np.float64]
    """(n, 3) world points."""
    colors: NDArray[np.uint8]
    """(n, 3) RGB of the points."""
    observations: Observations
    unplaced: Mapping[str, str] = field(default_factory=dict)
    """Names of the photographs that have no camera, with the reason of each."""
    mm_per_unit: float | None = None
    """Millimetres in one world unit; None: the scale is not known."""
    bounds: Bounds | None = None
    """Box around the object; None: not known."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """What else was found, for tables."""

    @property
    def n_registered(self) -> int:
        """Photographs that have a camera."""
        return len(self.cameras)

    @property
    def track_lengths(self) -> NDArray[np.int64]:
        """(n,) how many photographs show each point."""
        return np.bincount(self.observations.points, minlength=len(self.points)).astype(np.int64)

    @property
    def residuals(self) -> NDArray[np.float64]:
        """(n_observations,) pixels between where a point is seen and where its camera projects it."""
        found = np.empty(len(self.observations.views))
        for n, camera in enumerate(self.cameras):
            mine = self.observations.views == n
            projected = camera.project(self.points[self.observations.points[mine]])
            found[mine] = np.linalg.norm(projected - self.observations.pixels[mine], axis=1)
        return found

    @property
    def reprojection_error(self) -> float:
        """Mean of the residuals, pixels."""
        return float(self.residuals.mean())

    def summary(self) -> dict[str, object]:
        """Table of what was found."""
        lenses = {
            (camera.width, camera.height, *camera.K.ravel(), *camera.distortion): camera for camera in self.cameras
        }
        return {
            "photographs placed": f"{self.n_registered} of {self.n_registered + len(self.unplaced)}",
            "cameras": "; ".join(_lens(camera) for camera in lenses.values()),
            "points": len(self.points),
            **(
                {
                    "photographs a point": f"{self.track_lengths.mean():.1f}",
                    "reprojection error (pixels)": f"{self.reprojection_error:.2f}",
                }
                if len(self.points)
                else {}
            ),
            "scale": "not known" if self.mm_per_unit is None else f"{self.mm_per_unit:g} mm a unit",
            **self.notes,
            **{f"not placed: {name}": reason for name, reason in self.unplaced.items()},
        }


def upright_world(calibration: Calibration) -> Calibration:
    """The calibration in a world of its own: z up, origin among the points, cameras at a median distance of one.

    Up is where the photographs' upper sides point, on average.
    """
    ups = -np.array([camera.cam_from_world[1, :3] for camera in calibration.cameras])
    up = ups.mean(axis=0)
    up /= max(float(np.linalg.norm(up)), 1e-12)
    centers = np.array([camera.center for camera in calibration.cameras])
    origin = np.median(calibration.points, axis=0)
    scale = 1 / float(np.median(np.linalg.norm(centers - origin, axis=1)))
    R = _upright(up, centers[0] - origin, 1e-6 / scale)
    return transformed(calibration, Similarity(scale, R, -scale * R @ origin))


def level_world(calibration: Calibration, up: NDArray[np.float64], level: float) -> Calibration:
    """The calibration in a turned and raised world of the same unit: z up along a unit vector (3,), 0 at a level."""
    x_axis = np.array([1.0, 0, 0])
    R = _upright(up, x_axis, 1e-3)
    world = Similarity(1.0, R, np.array([0, 0, -level]))
    return transformed(calibration, world, mm_per_unit=calibration.mm_per_unit)


def _upright(up: NDArray[np.float64], ahead: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """(3, 3) rotation that takes a unit vector up to z and another to the x-z plane, if it is off up by a length."""
    x = ahead - (ahead @ up) * up
    if np.linalg.norm(x) < least:
        x = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def transformed(calibration: Calibration, world: Similarity, *, mm_per_unit: float | None = None) -> Calibration:
    """The calibration in another world frame, of that unit; bounds are lost."""
    cameras = (replace(camera, cam_from_world=world.camera(camera.cam_from_world)) for camera in calibration.cameras)
    points = world(calibration.points)
    return replace(calibration, cameras=tuple(cameras), points=points, mm_per_unit=mm_per_unit, bounds=None)


def _lens(camera: CalibratedCamera) -> str:
    K, (k1, k2, *_) = camera.K, camera.distortion
    text = f"{camera.width}x{camera.height}, f {K[0, 0]:.1f}, centre {K[0, 2]:.1f} {K[1, 2]:.1f}"
    return text + (f", k {k1:.3f} {k2:.3f}" if k1 or k2 else "")
