"""Arrays that travel together into kernels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Lattice(NamedTuple):
    """Voxels: index (i, j, k) spans origin + size * (i, j, k) to origin + size * (i + 1, j + 1, k + 1)."""

    shape: NDArray[np.int64]
    """(3,) voxels along each axis."""
    origin: NDArray[np.float64]
    """(3,) lowest corner, world units."""
    size: float
    """Edge of a voxel, world units."""


class Cameras(NamedTuple):
    """Cameras of all views."""

    projections: NDArray[np.float64]
    """(n_views, 3, 4) pixels from world."""
    centers: NDArray[np.float64]
    """(n_views, 3) world."""
    world_from_pixel: NDArray[np.float64]
    """(n_views, 3, 3) the point that pixel p shows at depth d is the centre + d * world_from_pixel (u, v, 1)."""
    sizes: NDArray[np.int64]
    """(n_views, 2) width and height, pixels; arrays of all images are as large as the largest."""
    focals: NDArray[np.float64]
    """(n_views,) focal lengths, pixels."""


class Window(NamedTuple):
    """How the pixels around a pixel are compared."""

    stride: int
    """Pixels between matched pixels."""
    radius: int
    """Pixels."""
    spacing: int
    """Between compared pixels, pixels."""
    contrast: float
    """Difference to the middle over which a pixel's weight falls to 1/e, grey levels."""
    min_deviation: float
    """Grey levels; windows with less have nothing to match."""


class Planes(NamedTuple):
    """What every stride-th pixel of a view, or of all views, shows."""

    planes: NDArray[np.float32]
    """(..., rows, columns, 3) inverse depth and its slopes along u and v."""
    costs: NDArray[np.float32]
    """(..., rows, columns) 1 - NCC; ``NOTHING`` where there is no match."""
