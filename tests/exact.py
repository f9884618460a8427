"""Distances to triangles, each triangle in turn."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray


def distance_to_triangle(
    points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances of points (..., 3) to a triangle: to its plane where the foot lies inside, else to the nearest side."""
    sides = ((a, b), (b, c), (c, a))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    height = (points - a) @ normal
    foot = points - height[..., None] * normal
    inside = np.all([np.cross(end - start, foot - start) @ normal >= 0 for start, end in sides], axis=0)

    def to_side(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
        return np.asarray(np.linalg.norm(points - start - along[..., None] * (end - start), axis=-1))

    return np.where(inside, np.abs(height), np.min([to_side(*side) for side in sides], axis=0))


def exact_distances(points: NDArray[np.float64], mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    """(n,) distances of points (n, 3) to a mesh."""
    distance = np.full(len(points), np.inf)
    for triangle in np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]:
        distance = np.minimum(distance, distance_to_triangle(points, *triangle))
    return distance
