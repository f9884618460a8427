"""What depth maps say of voxels, and of each other."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project, unproject
from recon3d.kernels.lattice import center_of
from recon3d.kernels.types import Cameras, DepthMaps, Lattice, Votes


@kernel(parallel=True)
def add_depths(
    part: Part,
    voxels: NDArray[np.int64],
    lattice: Lattice,
    cameras: Cameras,
    maps: DepthMaps,
    truncation: float,
    votes: Votes,
) -> None:
    """Add weighted truncated signed distances behind the depth maps at the centres of voxels (n, 3), and the weights.

    The votes hold sums, not means. A voxel farther than the truncation behind a view's surface learns nothing from that
    view.
    """
    depths, weights, stride = maps
    projections = cameras.projections
    distance, support = votes
    n_views, rows, columns = depths.shape
    for n in span(part, voxels.shape[0]):
        x, y, z = center_of(lattice, voxels[n, 0], voxels[n, 1], voxels[n, 2])
        total = distance[n]
        weight = support[n]
        for view in range(n_views):
            u, v, depth = project(projections[view], x, y, z)
            if depth <= 0.0:
                continue
            column = int(np.floor(u / stride + 0.5))
            row = int(np.floor(v / stride + 0.5))
            if row < 0 or column < 0 or row >= rows or column >= columns or weights[view, row, column] <= 0.0:
                continue
            behind = depth - depths[view, row, column]
            if behind > truncation:
                continue
            total += weights[view, row, column] * max(behind, -truncation)
            weight += weights[view, row, column]
        support[n] = weight
        distance[n] = total


@kernel(parallel=True)
def count_agreements(
    part: Part, cameras: Cameras, maps: DepthMaps, tolerance: float, counts: NDArray[np.int64]
) -> None:
    """In how many other views the depth map, where a pixel's point falls, has the point's own depth.

    The tolerance is far below any depth.
    """
    depths, _, stride = maps
    projections, world_from_pixel, centers, _, _ = cameras
    n_views, rows, columns = depths.shape
    for line in span(part, n_views * rows):
        view = line // rows
        row = line % rows
        for column in range(columns):
            z = depths[view, row, column]
            if z <= 0.0:
                continue
            point = unproject(centers[view], world_from_pixel[view], column * stride, row * stride, z)
            for other in range(n_views):
                a, b, depth = project(projections[other], point[0], point[1], point[2])
                if other == view or depth <= 0.0:
                    continue
                c = int(np.floor(a / stride + 0.5))
                r = int(np.floor(b / stride + 0.5))
                if 0 <= r < rows and 0 <= c < columns and abs(depths[other, r, c] - depth) <= tolerance:
                    counts[view, row, column] += 1
