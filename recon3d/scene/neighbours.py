"""Which views see about the same of the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import SceneError
from recon3d.scene.scene import Scene

_NEAREST_ANGLE, _FARTHEST_ANGLE = 5.0, 60.0  # degrees between viewing directions that can be matched


_OVERLAP_ANGLE = 90.0  # degrees between viewing directions that have much of the surface in common


def matching_neighbours(scene: Scene, most: int = 4) -> list[list[int]]:
    """For each view at most so many others, the nearest first, seen from the bounds' centre 5 to 60 degrees from it.

    Views less than 5 degrees apart count as one.

    Raises
    ------
    SceneError : no view has such a neighbour.
    """
    angles = viewing_angles(scene.centers, scene.bounds.center)
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


def overlapping_neighbours(scene: Scene, most: int = 32) -> NDArray[np.int64]:
    """(n_views, k) for each view the others that may see the same surface, the nearest first; -1 where there are fewer.

    Those whose directions from the bounds' centre lie at most 90 degrees apart; where these are more than so many, an
    even selection from the nearest to the farthest.
    """
    angles = viewing_angles(scene.centers, scene.bounds.center)
    np.fill_diagonal(angles, np.nan)
    chosen = []
    for row in angles:
        order = np.argsort(row, kind="stable")
        order = order[row[order] <= _OVERLAP_ANGLE]
        if len(order) > most:
            order = order[np.linspace(0, len(order) - 1, most).round().astype(np.int64)]
        chosen.append(order)
    table = np.full((len(chosen), max(map(len, chosen))), -1, np.int64)
    for row, others in zip(table, chosen, strict=True):
        row[: len(others)] = others
    return table


def viewing_angles(centers: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n_views, n_views) degrees between the directions in which cameras are seen from a place.

    NaN for a camera there, which is seen in no direction.

    Parameters
    ----------
    centers : (n_views, 3) camera centres, world.
    middle : (3,) the place, as the bounds' centre, world.
    """
    directions = centers - middle
    with np.errstate(invalid="ignore"):
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
