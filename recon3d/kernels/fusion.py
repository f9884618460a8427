"""Planes of several views, averaged where they agree.

A plane is three numbers at a pixel: inverse depth there, and its slopes along u and v.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.cameras import project, unproject
from recon3d.kernels.types import Camera


class PlaneMap(NamedTuple):
    """The planes of a view's pixels; row r and column c belong to pixel (u, v) = (c, r) times the stride."""

    planes: NDArray[np.float32]
    """(rows, columns, 3)."""
    normals: NDArray[np.float32]
    """(rows, columns, 3) unit, world, towards the camera."""
    weights: NDArray[np.float32]
    """(rows, columns); 0: no plane."""
    stride: int
    """Pixels between those that have a plane."""


class PlaneView(NamedTuple):
    """A view and its planes."""

    camera: Camera
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    map: PlaneMap


class Agreement(NamedTuple):
    """When planes of two views agree."""

    tolerance: float
    """Farthest that the other's plane passes from the point, world units."""
    min_cosine: float
    """Least cosine between the normals."""


class Means(NamedTuple):
    """Each pixel's plane with those of other views that agree, views weighing as they do; sums until finished."""

    points: NDArray[np.float64]
    """(rows, columns, 3) world; moved along the pixel's own normal."""
    normals: NDArray[np.float64]
    """(rows, columns, 3) unit, world."""
    colors: NDArray[np.float64]
    """(rows, columns, 3) RGB, 0 to 255."""
    support: NDArray[np.float64]
    """(rows, columns) sum of the weights."""
    offsets: NDArray[np.float64]
    """(rows, columns) sum of the weighted distances of the others' planes before the point, along the normal."""
    agreeing: NDArray[np.int32]
    """(rows, columns) how many other views agree."""
    contradicting: NDArray[np.int32]
    """(rows, columns) how many see a surface farther than three tolerances behind the point."""

    @classmethod
    def none(cls, rows: int, columns: int) -> "Means":
        """Those of no views."""
        points, normals, colors = np.zeros((3, rows, columns, 3))
        support, offsets = np.zeros((2, rows, columns))
        agreeing, contradicting = np.zeros((2, rows, columns), np.int32)
        return cls(points, normals, colors, support, offsets, agreeing, contradicting)


@kernel(parallel=True)
def start_means(part: Part, own: PlaneView, means: Means) -> None:
    """Sums of a view's planes alone; the means are zero before."""
    _, normals, weights, stride = own.map
    rows, columns = weights.shape
    for row in span(part, rows):
        for column in range(columns):
            weight = weights[row, column]
            if weight <= 0.0:
                continue
            means.support[row, column] = weight
            for axis in range(3):
                means.normals[row, column, axis] = weight * normals[row, column, axis]
                means.colors[row, column, axis] = weight * own.image[row * stride, column * stride, axis]


@kernel(parallel=True)
def add_agreeing(part: Part, own: PlaneView, other: PlaneView, agreement: Agreement, means: Means) -> None:
    """Add another view's planes that pass near the points of a view's pixels and face the same way."""
    _, normals, weights, stride = own.map
    other_planes, other_normals, other_weights, _ = other.map
    center, projection, size = other.camera.center, other.camera.projection, other.camera.size
    tolerance, min_cosine = agreement
    rows, columns = weights.shape
    other_rows, other_columns = other_weights.shape
    for row in span(part, rows):
        for column in range(columns):
            if weights[row, column] <= 0.0:
                continue
            x, y, z = _point(own, row, column)
            a, b, depth = project(projection, x, y, z)
            if depth <= 0.0:
                continue
            c = int(np.floor(a / stride + 0.5))
            r = int(np.floor(b / stride + 0.5))
            if r < 0 or c < 0 or r >= other_rows or c >= other_columns or other_weights[r, c] <= 0.0:
                continue
            plane = other_planes[r, c]
            inverse = plane[0] + plane[1] * (a - c * stride) + plane[2] * (b - r * stride)
            behind = 1.0 / inverse - depth if inverse > 0.0 else np.inf
            n = normals[row, column]
            m = other_normals[r, c]
            along = (m[0] * (x - center[0]) + m[1] * (y - center[1]) + m[2] * (z - center[2])) / depth
            if abs(along * behind) <= tolerance and n[0] * m[0] + n[1] * m[1] + n[2] * m[2] >= min_cosine:
                q = np.float64(other_weights[r, c])
                s = min(max(int(np.floor(a + 0.5)), 0), size[0] - 1)
                t = min(max(int(np.floor(b + 0.5)), 0), size[1] - 1)
                means.support[row, column] += q
                means.offsets[row, column] += q * along * behind
                for axis in range(3):
                    means.normals[row, column, axis] += q * m[axis]
                    means.colors[row, column, axis] += q * other.image[t, s, axis]
                means.agreeing[row, column] += 1
            elif behind > 3.0 * tolerance:
                means.contradicting[row, column] += 1


@kernel(parallel=True)
def finish_means(part: Part, own: PlaneView, means: Means) -> None:
    """Turn the sums into means, and find the points."""
    rows, columns = own.map.weights.shape
    for row in span(part, rows):
        for column in range(columns):
            if own.map.weights[row, column] <= 0.0:
                continue
            x, y, z = _point(own, row, column)
            n = own.map.normals[row, column]
            total = means.support[row, column]
            length = 0.0
            for axis in range(3):
                length += means.normals[row, column, axis] ** 2
            for axis in range(3):
                means.normals[row, column, axis] /= np.sqrt(length)
                means.colors[row, column, axis] /= total
            means.points[row, column, 0] = x + means.offsets[row, column] / total * n[0]
            means.points[row, column, 1] = y + means.offsets[row, column] / total * n[1]
            means.points[row, column, 2] = z + means.offsets[row, column] / total * n[2]


@kernel()
def _point(own: PlaneView, row: int, column: int) -> tuple[float, float, float]:
    """Where a pixel's plane crosses its ray."""
    stride = own.map.stride
    depth = 1.0 / own.map.planes[row, column, 0]
    return unproject(own.camera.center, own.camera.world_from_pixel, column * stride, row * stride, depth)
