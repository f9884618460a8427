"""Which views see a mesh's vertices."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.vertex_colors import facing_views
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene

_CLEARANCE = 0.1  # pixel footprints before a vertex where its line of sight ends


def vertex_visibility(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, caster: RayCaster | None = None
) -> NDArray[np.bool_]:
    """(n_views, n_vertices) whether a view sees a vertex of a mesh: from outside, nothing of the mesh in between.

    Parameters
    ----------
    caster : of the mesh, where there is one already.
    """
    if not mesh.has_vertex_normals():
        mesh = o3d.geometry.TriangleMesh(mesh)
        mesh.compute_vertex_normals()
    caster = caster or RayCaster(mesh)
    vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    # A vertex lies on triangles of its own, so its ray ends a little before it.
    ends = vertices + _CLEARANCE * scene.pixel_footprint * normals
    seen = np.empty((len(scene.views), len(vertices)), np.bool_)
    projections = np.stack([view.projection for view in scene.views])
    sizes = np.array([(view.width, view.height) for view in scene.views])
    facing_views(vertices, normals, projections, scene.centers, sizes, seen)
    for row, view in zip(seen, scene.views, strict=True):
        row[row] = ~caster.hidden(view.center, ends[row])
    return seen


def count_seeing_views(mesh: o3d.geometry.TriangleMesh, scene: Scene) -> NDArray[np.int64]:
    """(n_vertices,) how many views see each vertex of a mesh."""
    return np.asarray(vertex_visibility(mesh, scene).sum(axis=0))


def keep_vertices(mesh: o3d.geometry.TriangleMesh, kept: NDArray[np.bool_]) -> o3d.geometry.TriangleMesh:
    """The triangles whose vertices (n_vertices,) are all kept."""
    part = o3d.geometry.TriangleMesh(mesh)
    part.remove_triangles_by_mask(~kept[np.asarray(mesh.triangles)].all(axis=1))
    part.remove_unreferenced_vertices()
    return part


def without_unseen(mesh: o3d.geometry.TriangleMesh, scene: Scene) -> o3d.geometry.TriangleMesh:
    """The part of a mesh that some view sees: open where nobody looked, such as underneath.

    Raises
    ------
    EmptyReconstructionError : no view sees any of it.
    """
    seen = count_seeing_views(mesh, scene) > 0
    part = keep_vertices(mesh, seen)
    if not part.has_triangles():
        raise EmptyReconstructionError(f"scene {scene.name}: no view sees any of the surface")
    return part
