"""Colours of a mesh from the photographs that show it."""

from __future__ import annotations

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from recon3d.carving.views import ViewArrays
from recon3d.casting import RayCaster
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.vertex_colors import agreed_colors
from recon3d.rendering import pixel_rays, seeing_views
from recon3d.scene import Scene

_JUMP = 5.0  # pixel footprints of depth between neighbouring pixels that make an edge
_EDGE_WEIGHT = 0.05  # of a pixel at an edge: it counts where nothing better is there
_SWEEPS = 50  # edges that colours flow along the surface


def color_from_views(
    mesh: o3d.geometry.TriangleMesh, scene: Scene
) -> tuple[o3d.geometry.TriangleMesh, NDArray[np.int64]]:
    """A mesh with the colours that the photographs agree on at its vertices, and how many views see each vertex.

    Each view that sees a vertex (see ``seeing_views``) is sampled between its pixels. A view weighs by the square of
    the cosine at which it looks and of its resolution there, and hardly where its pixel lies beside a jump of depth
    or beside the silhouette, since what lies behind bleeds in there. Channel by channel the weighted median of the
    views counts: a highlight, or a view that is mistaken, with less than half the weight cannot draw it away. Where
    no view looks, colours flow in along the surface from the nearest that some view sees.

    Parameters
    ----------
    mesh : closed or open; its normals say which side is looked at.

    Returns
    -------
    mesh : a copy with vertex colours in [0, 1], and normals.
    support : (n_vertices,) how many views see each vertex; 0 where the colour flowed in.

    Raises
    ------
    EmptyReconstructionError : no view sees any vertex.

    References
    ----------
    Callieri, Cignoni, Corsini, Scopigno, "Masked photo blending: mapping dense photographic data set on
    high-resolution sampled 3D models", Computers & Graphics 2008 (weights by angle, resolution and distance to edges).
    Edgeworth, "On a new method of reducing observations relating to several quantities", 1888 (weighted median).
    """
    mesh = o3d.geometry.TriangleMesh(mesh)
    if not mesh.has_vertex_normals():
        mesh.compute_vertex_normals()
    points, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    views, caster = ViewArrays(scene), RayCaster(mesh)
    seen = seeing_views(mesh, scene, caster)
    if not seen.any():
        raise EmptyReconstructionError(f"scene {scene.name}: no view sees any of the surface, so it has no colours")
    colors = np.zeros((len(points), 3))
    agreed_colors(
        points, normals, seen, views.projections, views.centers, views.focals, views.sizes, views.images,
        _clean_pixels(caster, scene, views), _EDGE_WEIGHT, colors,
    )  # fmt: skip
    support = seen.sum(axis=0)
    _let_flow(colors, support > 0, points, np.asarray(mesh.triangles))
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.clip(colors / 255, 0, 1))
    return mesh, support


def _clean_pixels(caster: RayCaster, scene: Scene, views: ViewArrays) -> NDArray[np.bool_]:
    """(n_views, height, width) pixels two or more from a jump of depth, one or more inside the silhouette.

    Inverse depth is linear in the pixels of a plane, however steep, so its second difference tells jumps from slopes.
    """
    clean = np.zeros_like(views.foreground)
    second = np.array([[1.0, -2.0, 1.0]])
    window = np.ones((3, 3), np.uint8)
    for n, view in enumerate(scene.views):
        depth, _, _ = caster.first_hits(*pixel_rays(view.K, view.cam_from_world, view.width, view.height))
        inverse = 1 / depth
        bend = np.maximum(*(np.abs(cv2.filter2D(inverse, -1, kernel)) for kernel in (second, second.T)))
        edge = bend > _JUMP / views.focals[n] * cv2.dilate(inverse, window)
        edge |= ~views.foreground[n, : view.height, : view.width]
        clean[n, : view.height, : view.width] = cv2.dilate(edge.astype(np.uint8), window) == 0
    return clean


def _let_flow(
    colors: NDArray[np.float64], known: NDArray[np.bool_], points: NDArray[np.float64], triangles: NDArray[np.int32]
) -> None:
    """Fill in the unknown of (n, 3) colours: those of the nearest known in space, smoothed along the surface."""
    if known.all():
        return
    # A balanced tree takes seven times as long here.
    tree = cKDTree(points[known], balanced_tree=False, compact_nodes=False)
    flow = colors[known][tree.query(points[~known], workers=-1)[1]]
    edges = np.concatenate([triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2))])
    here, there = edges[~known[edges[:, 0]]].T
    row, inner, n = np.cumsum(~known) - 1, ~known[there], len(flow)
    links = coo_array((np.ones(inner.sum()), (row[here[inner]], row[there[inner]])), shape=(n, n)).tocsr()
    entering = np.empty_like(flow)
    for channel in range(3):
        entering[:, channel] = np.bincount(row[here[~inner]], colors[there[~inner], channel], minlength=n)
    together = 1 + np.bincount(row[here], minlength=n)[:, None]
    for _ in range(_SWEEPS):
        flow = (flow + links @ flow + entering) / together
    colors[~known] = flow
