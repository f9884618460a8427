"""Cameras around an object."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon3d.scene.scene import Scene

_ONE_SIDED = 0.7  # length of the mean of the cameras' unit forward axes
_SPREAD = 0.02  # mean square of the rows' directions along the second least of their axes
_ALONG_AXIS = np.cos(np.radians(15))


def up_direction(scene: Scene) -> NDArray[np.float64]:
    """(3,) unit axis that the cameras stand around, pointing to the side of the object from which they look down.

    The normal of the plane that fits the camera centres best. Cameras that all stand on one side of the object tell
    no such axis: then they are taken to have been held upright, and up is what is most at right angles to the rows of
    their images. The third world axis for fewer than three views.

    References
    ----------
    Szeliski, "Image alignment and stitching: a tutorial", 2006, section 5.2 (the global up vector).
    """
    centers = scene.centers
    if len(centers) < 3:
        return np.array([0.0, 0.0, 1.0])
    axes = np.array([view.cam_from_world[:3, :3] for view in scene.views])
    if np.linalg.norm(axes[:, 2].mean(axis=0)) > _ONE_SIDED:
        return _upright_photographs(axes)
    middle = centers.mean(axis=0)
    axis = np.asarray(np.linalg.svd(centers - middle)[2][2])
    above = (middle - scene.bounds.center) @ axis
    return axis if above >= 0 else -axis


def _upright_photographs(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) up of cameras by their axes in the world (n, 3, 3): right, down, forward."""
    upwards = -axes[:, 1].mean(axis=0)
    shares, directions = np.linalg.eigh(np.einsum("nd,ne->de", axes[:, 0], axes[:, 0]) / len(axes))
    # Where all rows point the same way, up and forward are both at right angles to them.
    up = directions[:, 0] if shares[1] > _SPREAD else upwards / np.linalg.norm(upwards)
    return np.asarray(up if up @ upwards >= 0 else -up)


def upright(scene: Scene, *, up: Literal["y", "z"], unit_mm: float) -> NDArray[np.float64]:
    """(4, 4) from the world to a frame that programs expect: an axis points up, lengths are in a common unit.

    Up is ``up_direction``; where an axis of the world lies within 15 degrees of that, the axis, which whoever made the
    world will have meant. What of the world's axes is horizontal stays so: with the world's z up, (x, y, z) becomes
    (x, z, -y) for "y".

    Parameters
    ----------
    unit_mm : millimetres in a unit of the frame. Where the scene's scale is not known, its lengths are kept.
    """
    found = up_direction(scene)
    nearest = np.eye(3)[np.abs(found).argmax()] * np.sign(found[np.abs(found).argmax()])
    axis = nearest if nearest @ found > _ALONG_AXIS else found
    side = np.eye(3)[0] if abs(axis[0]) < 0.9 else np.eye(3)[1]
    right = side - (side @ axis) * axis
    right /= np.linalg.norm(right)
    rows = [right, axis, np.cross(right, axis)] if up == "y" else [right, np.cross(axis, right), axis]
    scale = 1.0 if scene.mm_per_unit is None else scene.mm_per_unit / unit_mm
    frame_from_world = np.eye(4)
    frame_from_world[:3, :3] = scale * np.array(rows)
    return frame_from_world


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
