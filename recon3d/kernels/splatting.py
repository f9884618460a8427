"""Oriented points on a lattice."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel
from recon3d.kernels.types import Votes


class OrientedPoints(NamedTuple):
    """Points on a surface, in voxels, whose centres lie at integers."""

    points: NDArray[np.float32]
    """(n, 3)."""
    normals: NDArray[np.float32]
    """(n, 3) unit, outwards."""
    weights: NDArray[np.float32]
    """(n,)."""


@kernel()
def splat_planes(oriented: OrientedPoints, sigma: float, radius: int, votes: Votes) -> None:
    """Add to voxels around points their weights, and those times the centres' distances behind their planes.

    All lengths are in voxels; weights fall off as a Gaussian, to the radius along each axis.
    """
    points, normals, weights = oriented
    distance, support = votes
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
