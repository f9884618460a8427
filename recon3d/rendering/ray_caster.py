"""Rays and distances to a mesh, by Open3D's ray caster."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray


class Hits(NamedTuple):
    """What rays hit first."""

    distance: NDArray[np.float32]
    """(...,) in lengths of the rays' directions; infinite where nothing is hit."""
    triangle: NDArray[np.uint32]
    """(...,) of no meaning where nothing is hit, as are the weights."""
    uv: NDArray[np.float32]
    """(..., 2) weights of the triangle's second and third corner."""


class RayCaster:
    """A mesh that can be asked what a ray hits and how far a point is.

    Open3D computes in single precision, so everything is moved to the mesh's middle first, in a unit of about the
    mesh's size: neither a world's unit nor a place far from its origin costs digits.
    """

    def __init__(self, mesh: o3d.geometry.TriangleMesh) -> None:
        box = mesh.get_axis_aligned_bounding_box()
        self._middle = np.asarray(box.get_center())
        self._unit = power_of_two(box.get_max_extent())
        self._scene = o3d.t.geometry.RaycastingScene()
        moved = o3d.geometry.TriangleMesh(mesh.vertices, mesh.triangles)
        moved.translate(-self._middle)
        moved.scale(1 / self._unit, np.zeros(3))
        self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(moved))

    def first_hits(self, origin: NDArray[np.float64], directions: NDArray[np.float64]) -> Hits:
        """What rays (..., 3) from one point hit first."""
        rays = np.empty((*directions.shape[:-1], 6), np.float32)
        rays[..., :3] = self._local(origin)
        rays[..., 3:] = directions
        answer = self._scene.cast_rays(o3d.core.Tensor.from_numpy(rays))
        distance, triangle, uv = (answer[name].numpy() for name in ("t_hit", "primitive_ids", "primitive_uvs"))
        return Hits(distance * np.float32(self._unit), triangle, uv)

    def hidden(self, origin: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether something of the mesh lies between one point and each of points (n, 3)."""
        start = np.broadcast_to(self._local(origin), points.shape)
        rays = np.concatenate([start, (points - origin) / self._unit], axis=1).astype(np.float32)
        return np.asarray(self._scene.test_occlusions(o3d.core.Tensor.from_numpy(rays), 0.0, 1.0).numpy())

    def crossings(self, origins: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) how many triangles a ray from each origin (n, 3) crosses in a direction."""
        rays = np.concatenate([self._local(origins), np.broadcast_to(direction, origins.shape)], axis=1)
        counts = self._scene.count_intersections(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
        return np.asarray(counts.numpy(), np.int64)

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) exact distances of points (n, 3) to the triangles."""
        moved = o3d.core.Tensor.from_numpy(self._local(points).astype(np.float32))
        return self._unit * np.asarray(self._scene.compute_distance(moved).numpy(), np.float64)

    def _local(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points (..., 3) as the ray caster holds them."""
        return np.asarray((points - self._middle) / self._unit)


def power_of_two(length: float) -> float:
    """The power of two nearest to a length, by which numbers are divided without rounding; 1 for none."""
    return float(2.0 ** round(np.log2(length))) if length > 0 else 1.0
