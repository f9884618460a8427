"""Signed distance to silhouettes, sampled at voxel centres."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from recon3d.kernels import kernel


@kernel(parallel=True)
def silhouette_distance(
    origin: NDArray[np.float64],
    size: float,
    projections: NDArray[np.float64],
    image_sizes: NDArray[np.int64],
    pixel_scales: NDArray[np.float64],
    distances: NDArray[np.float32],
    tolerance: int,
    field: NDArray[np.float32],
) -> None:
    """(tolerance + 1)-th smallest signed distance over the views of every voxel's centre, world units.

    distances holds a signed distance in pixels per view, positive inside; pixel_scales is a pixel's size at depth one.
    Views that do not show the centre do not count; with fewer views than the rank field keeps its value.
    """
    nx, ny, nz = field.shape
    for i in prange(nx):
        smallest = np.empty(tolerance + 1, np.float64)
        for j in range(ny):
            for k in range(nz):
                x = origin[0] + (i + 0.5) * size
                y = origin[1] + (j + 0.5) * size
                z = origin[2] + (k + 0.5) * size
                smallest[:] = np.inf
                for view in range(projections.shape[0]):
                    P = projections[view]
                    depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
                    if depth <= 0.0:
                        continue
                    u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
                    v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
                    width, height = image_sizes[view, 0], image_sizes[view, 1]
                    if not (u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5):
                        continue
                    value = bilinear(distances[view], u, v, width, height) * depth * pixel_scales[view]
                    for rank in range(tolerance + 1):
                        if value < smallest[rank]:
                            smallest[rank], value = value, smallest[rank]
                if smallest[tolerance] < field[i, j, k]:
                    field[i, j, k] = smallest[tolerance]


@kernel()
def bilinear(image: NDArray[np.float32], u: float, v: float, width: int, height: int) -> float:
    """Value of an image at a sub-pixel place, the border's value beyond the outermost pixel centres."""
    u = min(max(u, 0.0), width - 1.0)
    v = min(max(v, 0.0), height - 1.0)
    u0 = min(int(u), width - 2)
    v0 = min(int(v), height - 2)
    a = u - u0
    b = v - v0
    return (1 - b) * ((1 - a) * image[v0, u0] + a * image[v0, u0 + 1]) + b * (
        (1 - a) * image[v0 + 1, u0] + a * image[v0 + 1, u0 + 1]
    )
