"""Which views see a mesh's vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.kernels.vertex_colors import Vertices, facing_views
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene

_CLEARANCE = 0.1  # pixel footprints before a vertex where its line of sight ends


@dataclass(frozen=True)
class VertexVisibility:
    """Which views see which vertices of a mesh: from outside, nothing of the mesh in between."""

    seen: NDArray[np.bool_]
    """(n_views, n_vertices)."""

    @classmethod
    def of(cls, mesh: o3d.geometry.TriangleMesh, scene: Scene, caster: RayCaster | None = None) -> VertexVisibility:
        """Find the views that see each vertex of a mesh.

        Parameters
        ----------
        mesh : closed or open; its normals say which side is looked at.
        caster : of the mesh, where there is one already.
        """
        if not mesh.has_vertex_normals():
            mesh = o3d.geometry.TriangleMesh(mesh)
            mesh.compute_vertex_normals()
        caster = caster or RayCaster(mesh)
        vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
        # A vertex lies on triangles of its own, so its ray ends a little before it.
        ends = vertices + _CLEARANCE * scene.pixel_footprint * normals
        cameras = scene.cameras
        seen = np.empty((len(scene.views), len(vertices)), np.bool_)
        facing_views(Vertices(vertices, normals), cameras, seen)
        for row, center in zip(seen, cameras.centers, strict=True):
            row[row] = ~caster.hidden(center, ends[row])
        return cls(seen)

    @property
    def n_views(self) -> NDArray[np.int64]:
        """(n_vertices,) how many views see each vertex."""
        return np.asarray(self.seen.sum(axis=0), np.int64)

    def of_vertices(self, index: NDArray[np.int64]) -> VertexVisibility:
        """Of a mesh whose vertices are copies of those at an index (n,)."""
        return VertexVisibility(self.seen[:, index])


def keep_vertices(mesh: o3d.geometry.TriangleMesh, kept: NDArray[np.bool_]) -> o3d.geometry.TriangleMesh:
    """The triangles whose vertices (n_vertices,) are all kept."""
    part = o3d.geometry.TriangleMesh(mesh)
    part.remove_triangles_by_mask(~kept[np.asarray(mesh.triangles)].all(axis=1))
    part.remove_unreferenced_vertices()
    return part
