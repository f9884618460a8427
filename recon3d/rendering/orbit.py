"""Cameras around an object."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from recon3d.scene.scene import Scene


def up_direction(scene: Scene) -> NDArray[np.float64]:
    """(3,) unit axis that the cameras stand around, pointing to the side of the object from which they look down.

    The normal of the plane that fits the camera centres best; the third world axis for fewer than three views.
    """
    centers = scene.centers
    if len(centers) < 3:
        return np.array([0.0, 0.0, 1.0])
    middle = centers.mean(axis=0)
    axis = np.asarray(np.linalg.svd(centers - middle)[2][2])
    above = (middle - scene.bounds.center) @ axis
    return axis if above >= 0 else -axis


def _orbit(
    center: NDArray[np.float64], radius: float, up: NDArray[np.float64], frames: int, size: int
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """K and cam_from_world of square cameras around a point, 15 degrees above it."""
    side = np.eye(3)[np.abs(up).argmin()]
    east = np.cross(up, side)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    elevation = np.radians(15)
    distance = 4 * radius
    K = np.array([[1.9 * size, 0, (size - 1) / 2], [0, 1.9 * size, (size - 1) / 2], [0, 0, 1]])
    for angle in np.arange(frames) * 2 * np.pi / frames:
        away = np.cos(elevation) * (np.cos(angle) * east + np.sin(angle) * north) + np.sin(elevation) * up
        yield K, look_at(center + distance * away, center, up)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) cam_from_world of an upright camera at a point that looks at another."""
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = R
    cam_from_world[:3, 3] = -R @ eye
    return cam_from_world
