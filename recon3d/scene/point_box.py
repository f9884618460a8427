"""A box around sparse points of what photographs show, or around what stands on a plane among them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds, place_text
from recon3d.scene.ground import TABLE_LEFT_OUT, SupportingPlane
from recon3d.scene.view import View

PADDING = 0.06
"""Fraction of the longest side added around a box that was found from points."""

_FEWEST = 30  # points
_OUTLIERS = 2  # percent of the points at each end of an axis
_ALONG = 0.94  # cosine between an axis of the world and the plane's normal from which on a side lies on the plane


def box_of_points(
    points: NDArray[np.float64],
    views: Sequence[View],
    middle: NDArray[np.float64],
    reach: float,
    plane: SupportingPlane | None = None,
) -> tuple[Bounds, str] | None:
    """Box around the points that most views may see, and how it was found; None: there are too few.

    Parameters
    ----------
    points : (n, 3) of what the photographs show, world.
    middle : (3,) where the cameras look, world.
    reach : distance from there, along each axis, within which points are looked at, world units.
    plane : found among the points; the box is of what stands on it.
    """
    counts = np.sum([view.sees(points) for view in views], axis=0)
    near = np.abs(points - middle).max(axis=1) < reach
    kept = _seen_by_most(near if plane is None else near & ~plane.points, counts)
    if kept.sum() < _FEWEST:
        return None
    told = f"found from {int(kept.sum())} of {len(points)} points"
    if plane is not None:
        through, normal = place_text(plane.feet(middle[None])[0], reach), place_text(plane.normal.round(3) + 0.0, 1.0)
        left_out = f"plane at {through}, its normal {normal}, {int(plane.points.sum())} of {len(points)} points"
        return _above(points[kept], plane), f"{told}; {TABLE_LEFT_OUT}: {left_out}"
    box = _trimmed(points[kept])
    return box.padded(PADDING * box.longest), told


def _seen_by_most(near: NDArray[np.bool_], counts: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of near points at least as many views see as half of them."""
    return np.asarray(near & (counts >= max(2, np.median(counts[near]) if near.any() else 0)))


def _trimmed(points: NDArray[np.float64]) -> Bounds:
    return Bounds(*np.percentile(points, [_OUTLIERS, 100 - _OUTLIERS], axis=0))


def _above(points: NDArray[np.float64], plane: SupportingPlane) -> Bounds:
    """Padded box around points (n, 3) that stand on a plane, and around their feet; a side along the plane is on it."""
    box = _trimmed(points)
    inner = points[((points >= box.low) & (points <= box.high)).all(axis=1)]
    feet = plane.feet(inner if len(inner) else points)
    low, high = np.minimum(box.low, feet.min(axis=0)), np.maximum(box.high, feet.max(axis=0))
    padded = Bounds(low, high).padded(PADDING * Bounds(low, high).longest)
    along = plane.normal > _ALONG, plane.normal < -_ALONG
    return Bounds(
        np.where(along[0], low + plane.thickness, padded.low), np.where(along[1], high - plane.thickness, padded.high)
    )
