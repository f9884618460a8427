"""Which views see about the same of the object."""

from __future__ import annotations

import numpy as np

from recon3d.errors import SceneError
from recon3d.scene.scene import Scene

_NEAREST_ANGLE, _FARTHEST_ANGLE = 5.0, 60.0  # degrees between viewing directions that can be matched


def matching_neighbours(scene: Scene, most: int = 4) -> list[list[int]]:
    """For each view at most so many others, the nearest first, seen from the bounds' centre 5 to 60 degrees from it.

    Views less than 5 degrees apart count as one.

    Raises
    ------
    SceneError : no view has such a neighbour.
    """
    directions = scene.centers - scene.bounds.center
    with np.errstate(invalid="ignore"):  # a camera in the middle has no direction, so no neighbours
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    chosen: list[list[int]] = []
    for row in angles:
        left = np.argsort(row, kind="stable")
        left = left[(row[left] >= _NEAREST_ANGLE) & (row[left] <= _FARTHEST_ANGLE)]
        others: list[int] = []
        while len(left) and len(others) < most:
            others.append(int(left[0]))
            left = left[angles[left, left[0]] >= _NEAREST_ANGLE]
        chosen.append(others)
    if not any(chosen):
        raise SceneError(f"scene {scene.name}: no two views lie 5 to 60 degrees apart, so none can be matched")
    return chosen
