"""Distances of points to triangles."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.types import Nearest

_FLAT = 1e-16  # squared sine of an angle at which rounding of the normal costs as much as leaving out the inside


@kernel()
def _cross(ux: float, uy: float, uz: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Cross product u x v."""
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel()
def _to_edge(ux: float, uy: float, uz: float, x: float, y: float, z: float) -> float:
    """Squared distance of a point u to the segment from the origin to (x, y, z)."""
    length = x * x + y * y + z * z
    along = min(max((ux * x + uy * y + uz * z) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return (ux - along * x) ** 2 + (uy - along * y) ** 2 + (uz - along * z) ** 2


@kernel()
def to_triangle(p: NDArray[np.float64], corners: NDArray[np.float64]) -> float:
    """Squared distance of a point (3,) to a triangle (3, 3): to its edges, or to its plane before its inside.

    The edges are right, and all that counts, where a triangle is too thin to have a normal.
    """
    a, b, c = corners[0], corners[1], corners[2]
    px, py, pz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    squared = min(
        _to_edge(px, py, pz, bx, by, bz),
        _to_edge(px, py, pz, cx, cy, cz),
        _to_edge(px - bx, py - by, pz - bz, cx - bx, cy - by, cz - bz),
    )
    nx, ny, nz = _cross(bx, by, bz, cx, cy, cz)
    normal = nx * nx + ny * ny + nz * nz
    if normal <= _FLAT * (bx * bx + by * by + bz * bz) * (cx * cx + cy * cy + cz * cz):
        return squared
    x, y, z = _cross(px, py, pz, cx, cy, cz)
    weight_b = x * nx + y * ny + z * nz
    x, y, z = _cross(bx, by, bz, px, py, pz)
    weight_c = x * nx + y * ny + z * nz
    if weight_b < 0.0 or weight_c < 0.0 or weight_b + weight_c > normal:
        return squared
    return min(squared, (px * nx + py * ny + pz * nz) ** 2 / normal)


@kernel(parallel=True)
def nearest_of(
    part: Part,
    points: NDArray[np.float64],
    corners: NDArray[np.float64],
    candidates: NDArray[np.int64],
    starts: NDArray[np.int64],
    nearest: Nearest,
) -> None:
    """Lower each point's distance (n, 3) to the least of those to its triangles' corners (n_triangles, 3, 3).

    Those of point n are ``candidates[starts[n] : starts[n + 1]]``.
    """
    squared, triangle = nearest
    for n in span(part, points.shape[0]):
        for place in range(starts[n], starts[n + 1]):
            distance = to_triangle(points[n], corners[candidates[place]])
            if distance < squared[n]:
                squared[n] = distance
                triangle[n] = candidates[place]
