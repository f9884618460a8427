"""Which views see about the same of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import SceneError
from recon3d.scene.scene import Scene

_NEAREST_ANGLE, _FARTHEST_ANGLE = 5.0, 60.0  # degrees between lines of sight that can be matched

_OVERLAP_ANGLE = 90.0  # degrees between lines of sight to much of the same surface

_SAME_ANGLE = 0.5  # degrees between lines of sight below which two views are one

_PLACES = 2048, 512  # in the bounds: of few views, and of many

_PAIRS = 2e7  # of views, times places

_LEAST_SHARE = 0.25  # of what a view shares with any other

_SAME_SHARE = 0.5  # of what a view sees that one beside it sees, too, where both count as one

_SAME_SCALE = 1.5  # ratio of the pixels' footprints from which on a view is the farther for it


@dataclass(frozen=True)
class Overlap:
    """What each two views see together of some places, and from how different directions."""

    shares: NDArray[np.float64]
    """(n_views, n_views) share in [0, 1] of what a view (row) sees that another (column) sees, too; 0: nothing."""
    angles: NDArray[np.float64]
    """(n_views, n_views) degrees between their lines of sight, mean; NaN: they share nothing, or are one view."""
    scales: NDArray[np.float64]
    """(n_views, n_views) the larger of their pixels' footprints over the smaller, mean; NaN as the angles."""

    @classmethod
    def of(cls, scene: Scene, places: NDArray[np.float64], seen: NDArray[np.bool_] | None = None) -> Overlap:
        """Of places (n, 3), world, that views see (n_views, n); when None those in their images see them."""
        if seen is None:
            seen = np.array([view.sees(places) for view in scene.views])
        toward = scene.centers[:, None] - places
        distances = np.linalg.norm(toward, axis=2)
        toward = np.divide(toward, distances[..., None], out=np.zeros_like(toward), where=distances[..., None] > 0)
        footprints = np.maximum(distances, 1e-300) / scene.cameras.focals[:, None]
        n = len(scene.views)
        shares, angles, scales = np.zeros((n, n)), np.full((n, n), np.nan), np.full((n, n), np.nan)
        for view in range(n):
            at = np.flatnonzero(seen[view])
            others = np.flatnonzero(seen[:, at].any(axis=1) & (np.arange(n) != view))
            both, own = seen[np.ix_(others, at)], footprints[view, at]
            counts = both.sum(axis=1)
            shares[view, others] = counts / max(len(at), 1)
            cosines = np.einsum("vni,ni->vn", toward[np.ix_(others, at)], toward[view, at])
            between = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
            theirs = footprints[np.ix_(others, at)]
            ratios = np.maximum(theirs, own) / np.minimum(theirs, own)
            angles[view, others] = (between * both).sum(axis=1) / counts
            scales[view, others] = (ratios * both).sum(axis=1) / counts
        return cls(shares, angles, scales)

    @classmethod
    def in_bounds(cls, scene: Scene) -> Overlap:
        """Of places all over the scene's bounds, as if nothing hid any of them."""
        most, fewest = _PLACES
        wanted = _PAIRS / len(scene.views) ** 2
        return cls.of(scene, scene.bounds.places(int(np.clip(wanted, fewest, most))))


def matching_neighbours(scene: Scene, most: int = 4, overlap: Overlap | None = None) -> list[list[int]]:
    """For each view at most so many others that it can be matched with, the nearest first.

    Their lines of sight lie 5 to 60 degrees apart, and they see at least a quarter of what the one sees that shares
    most. Nearness is the angle, in proportion larger where the footprints' ratio is above 1.5. Of views less than
    5 degrees apart that see about the same, the nearest counts alone.

    Parameters
    ----------
    overlap : of places on the object; of all in the bounds when None.

    Raises
    ------
    SceneError : no view has such a neighbour.
    """
    shares, angles, scales = vars(overlap or Overlap.in_bounds(scene)).values()
    chosen: list[list[int]] = []
    for share, angle, scale in zip(shares, angles, scales, strict=True):
        possible = (angle >= _NEAREST_ANGLE) & (angle <= _FARTHEST_ANGLE)
        possible &= share >= _LEAST_SHARE * np.max(share, where=possible, initial=0)
        far = np.round(angle * np.maximum(scale / _SAME_SCALE, 1), 6)  # of equal ones the first, whatever the rounding
        left = np.argsort(far, kind="stable")
        left = left[possible[left]]
        others: list[int] = []
        while len(left) and len(others) < most:
            first = int(left[0])
            others.append(first)
            same = (angles[left, first] < _NEAREST_ANGLE) & (shares[left, first] >= _SAME_SHARE)
            left = left[~same & (left != first)]
        chosen.append(others)
    if not any(chosen):
        raise SceneError(f"scene {scene.name}: no two views lie 5 to 60 degrees apart, so none can be matched")
    return chosen


def overlapping_neighbours(scene: Scene, most: int = 32) -> NDArray[np.int64]:
    """(n_views, k) for each view the others that may see the same surface, the nearest first; -1 where there are fewer.

    Those that see places in the bounds at most 90 degrees from where it sees them; where these are more than so many,
    an even selection from the nearest to the farthest. Views from the same place do not count: they err alike.
    """
    angles = np.round(Overlap.in_bounds(scene).angles, 6)
    chosen = []
    for row in angles:
        order = np.argsort(row, kind="stable")
        order = order[(row[order] >= _SAME_ANGLE) & (row[order] <= _OVERLAP_ANGLE)]
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
