"""Oriented points on a lattice."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel


@kernel()
def splat_planes(
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    weights: NDArray[np.float32],
    sigma: float,
    radius: int,
    support: NDArray[np.float32],
    distance: NDArray[np.float32],
) -> None:
    """Add to voxels around points (n, 3) their weights, and those times the centres' distances behind their planes.

    All lengths are in voxels, whose centres lie at integers; weights fall off as a Gaussian, to the radius along each
    axis.
    """
    side = 2 * radius + 1
    fall, low = np.empty((3, side)), np.empty(3, np.int64)
    for n in range(points.shape[0]):
        for axis in range(3):
            low[axis] = int(np.floor(points[n, axis] + 0.5)) - radius
            for o in range(side):
                fall[axis, o] = np.exp(-0.5 * ((points[n, axis] - low[axis] - o) / sigma) ** 2)
        for i in range(max(low[0], 0), min(low[0] + side, support.shape[0])):
            for j in range(max(low[1], 0), min(low[1] + side, support.shape[1])):
                across = weights[n] * fall[0, i - low[0]] * fall[1, j - low[1]]
                behind = (points[n, 0] - i) * normals[n, 0] + (points[n, 1] - j) * normals[n, 1]
                for k in range(max(low[2], 0), min(low[2] + side, support.shape[2])):
                    weight = across * fall[2, k - low[2]]
                    support[i, j, k] += weight
                    distance[i, j, k] += weight * (behind + (points[n, 2] - k) * normals[n, 2])
