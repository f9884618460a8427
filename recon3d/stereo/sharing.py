"""Which views are matched, by what they see of the surface that is known so far."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from recon3d.errors import SceneError
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.neighbours import Overlap, matching_neighbours
from recon3d.scene.scene import Scene
from recon3d.surface.sights import Sights

_PLACES = 2000  # on the surface that are looked at, at most


def surface_neighbours(
    scene: Scene, surface: o3d.geometry.TriangleMesh, most: int, *, clearance: float
) -> list[list[int]]:
    """``matching_neighbours`` by the vertices of a surface that two views see, neither hidden nor at a grazing angle.

    A view that shares none of them with any goes by the places in the bounds.

    Parameters
    ----------
    surface : with vertex normals.
    clearance : before a vertex where its lines of sight end, world units.

    Raises
    ------
    SceneError : no two views can be matched.
    """
    vertices, normals = np.asarray(surface.vertices), np.asarray(surface.vertex_normals)
    chosen = np.unique(np.linspace(0, len(vertices) - 1, min(_PLACES, len(vertices))).astype(np.int64))
    cameras = [view.calibration for view in scene.views]
    sights = Sights.of(cameras, vertices[chosen], normals[chosen], RayCaster(surface), clearance)
    by_bounds = matching_neighbours(scene, most)
    try:
        by_surface = matching_neighbours(scene, most, Overlap.of(scene, vertices[chosen], sights.steep))
    except SceneError:
        return by_bounds
    return [own or others for own, others in zip(by_surface, by_bounds, strict=True)]
