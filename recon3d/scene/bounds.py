"""The box around the object."""

from __future__ import annotations

from itertools import product

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray


def make_bounds(low: ArrayLike, high: ArrayLike) -> o3d.geometry.AxisAlignedBoundingBox:
    """Axis-aligned box from two opposite corners (3,) in world units."""
    a, b = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if a.shape != (3,) or b.shape != (3,) or not np.isfinite([a, b]).all():
        raise ValueError(f"expected two corners of three finite numbers, got {low!r} and {high!r}")
    return o3d.geometry.AxisAlignedBoundingBox(np.minimum(a, b), np.maximum(a, b))


def bounds_corners(bounds: o3d.geometry.AxisAlignedBoundingBox) -> NDArray[np.float64]:
    """(8, 3) corners of a box."""
    sides = np.stack([bounds.min_bound, bounds.max_bound])
    return np.array([[sides[c, axis] for axis, c in enumerate(corner)] for corner in product((0, 1), repeat=3)])
