"""Planes of several views, averaged where they agree.

A plane is three numbers at a pixel: inverse depth there, and its slopes along u and v.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project, unproject
from recon3d.kernels.types import Cameras


class PlaneMaps(NamedTuple):
    """The planes of all views' pixels; row r and column c belong to pixel (u, v) = (c, r) times the stride."""

    planes: NDArray[np.float32]
    """(n_views, rows, columns, 3)."""
    normals: NDArray[np.float32]
    """(n_views, rows, columns, 3) unit, world, towards the camera."""
    weights: NDArray[np.float32]
    """(n_views, rows, columns); 0: no plane."""
    stride: int
    """Pixels between those that have a plane."""


class Agreement(NamedTuple):
    """When planes of two views agree."""

    asked: NDArray[np.int64]
    """(n_views, k) each view's others, up to a -1."""
    tolerance: float
    """Farthest that the other's plane passes from the point, world units."""
    min_cosine: float
    """Least cosine between the normals."""


class Means(NamedTuple):
    """Each pixel's plane with those of other views that agree, views weighing as they do."""

    points: NDArray[np.float64]
    """(n_views, rows, columns, 3) world; moved along the pixel's own normal."""
    normals: NDArray[np.float64]
    """(n_views, rows, columns, 3) unit, world."""
    colors: NDArray[np.float64]
    """(n_views, rows, columns, 3) RGB, 0 to 255."""
    support: NDArray[np.float64]
    """(n_views, rows, columns) sum of the weights."""
    agreeing: NDArray[np.int64]
    """(n_views, rows, columns) how many other views agree."""
    contradicting: NDArray[np.int64]
    """(n_views, rows, columns) how many see a surface farther than three tolerances behind the point."""


@kernel(parallel=True)
def average_planes(
    part: Part, cameras: Cameras, images: NDArray[np.uint8], maps: PlaneMaps, agreement: Agreement, means: Means
) -> None:
    """Mean of each pixel's plane with those of other views that pass near its point and face the same way.

    The means are zero before.
    """
    projections, world_from_pixel, centers, _, sizes = cameras
    planes, normals, weights, stride = maps
    asked, tolerance, min_cosine = agreement
    points, mean_normals, colors, support, agreeing, contradicting = means
    n_views, rows, columns = weights.shape
    for line in span(part, n_views * rows):
        view = line // rows
        row = line % rows
        for column in range(columns):
            own = weights[view, row, column]
            if own <= 0.0:
                continue
            u = column * stride
            v = row * stride
            depth = 1.0 / planes[view, row, column, 0]
            x, y, z = unproject(centers[view], world_from_pixel[view], u, v, depth)
            n = normals[view, row, column]
            total = np.float64(own)
            offset = 0.0
            for axis in range(3):
                mean_normals[view, row, column, axis] = own * n[axis]
                colors[view, row, column, axis] = own * images[view, v, u, axis]
            for other in asked[view]:
                if other < 0:
                    break
                a, b, depth = project(projections[other], x, y, z)
                if depth <= 0.0:
                    continue
                c = int(np.floor(a / stride + 0.5))
                r = int(np.floor(b / stride + 0.5))
                if r < 0 or c < 0 or r >= rows or c >= columns or weights[other, r, c] <= 0.0:
                    continue
                plane = planes[other, r, c]
                inverse = plane[0] + plane[1] * (a - c * stride) + plane[2] * (b - r * stride)
                behind = 1.0 / inverse - depth if inverse > 0.0 else np.inf
                m = normals[other, r, c]
                along = (
                    m[0] * (x - centers[other, 0]) + m[1] * (y - centers[other, 1]) + m[2] * (z - centers[other, 2])
                ) / depth
                if abs(along * behind) <= tolerance and n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= min_cosine:
                    q = np.float64(weights[other, r, c])
                    s = min(max(int(np.floor(a + 0.5)), 0), sizes[other, 0] - 1)
                    t = min(max(int(np.floor(b + 0.5)), 0), sizes[other, 1] - 1)
                    total += q
                    offset += q * along * behind
                    for axis in range(3):
                        mean_normals[view, row, column, axis] += q * m[axis]
                        colors[view, row, column, axis] += q * images[other, t, s, axis]
                    agreeing[view, row, column] += 1
                elif behind > 3.0 * tolerance:
                    contradicting[view, row, column] += 1
            length = 0.0
            for axis in range(3):
                length += mean_normals[view, row, column, axis] ** 2
            for axis in range(3):
                mean_normals[view, row, column, axis] /= np.sqrt(length)
                colors[view, row, column, axis] /= total
            points[view, row, column, 0] = x + offset / total * n[0]
            points[view, row, column, 1] = y + offset / total * n[1]
            points[view, row, column, 2] = z + offset / total * n[2]
            support[view, row, column] = total
