"""Colours of a mesh from the photographs that show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.vertex_colors import Samples, Vertices, agreed_colors, sample_view
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene
from recon3d.scratch import Scratch
from recon3d.surface.trust import trusted_pixels
from recon3d.surface.visibility import VertexVisibility

_SWEEPS = 50  # edges that colours flow along the surface


_BATCH = 1 << 16  # vertices at a time


def color(
    mesh: o3d.geometry.TriangleMesh,
    scene: Scene,
    *,
    visibility: VertexVisibility | None = None,
    caster: RayCaster | None = None,
) -> o3d.geometry.TriangleMesh:
    """A mesh with the colours that the photographs agree on at its vertices.

    Each view that sees a vertex is sampled between its pixels. A view weighs by the number of pixels that it has for
    an area of the surface (cosine over footprint squared), and hardly where its pixel lies beside a jump of depth,
    since what lies behind bleeds in there; a pixel in the background or beside it is not asked. Channel by channel the
    weighted median of the views counts: a highlight, or a view that is mistaken, cannot draw it away from what the
    others agree on. Where no view can be asked, colours flow in along the surface from where one can.

    Parameters
    ----------
    mesh : closed or open; its normals say which side is looked at.
    visibility : of the mesh's vertices in the scene's views, where it is known already.
    caster : of what hides the mesh, where there is one already; the mesh itself when None.

    Returns
    -------
    o3d.geometry.TriangleMesh
        A copy with vertex colours in [0, 1], and normals.

    Raises
    ------
    EmptyReconstructionError : no view shows any vertex.

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
    caster = caster or RayCaster(mesh)
    visibility = visibility or VertexVisibility.of(mesh, scene, caster)
    if visibility.seen.shape != (len(scene.views), len(points)):
        raise ArgumentError(
            f"expected the visibility of {len(points):,} vertices in {len(scene.views)} views, "
            f"got {visibility.seen.shape[1]:,} in {visibility.seen.shape[0]}"
        )
    colors = _agreed(Vertices(points, normals), visibility.seen, scene, caster)
    known = np.isfinite(colors[:, 0])
    if not known.any():
        raise EmptyReconstructionError(f"scene {scene.name}: no view shows any of the surface, so it has no colours")
    let_flow(colors, known, points, np.asarray(mesh.triangles))
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.clip(colors / 255, 0, 1))
    return mesh


@dataclass(frozen=True)
class _Sampled:
    """What a view shows of the vertices that it sees, in their order."""

    colors: NDArray[np.float64]
    weights: NDArray[np.float64]


def _agreed(vertices: Vertices, seen: NDArray[np.bool_], scene: Scene, caster: RayCaster) -> NDArray[np.float64]:
    """(n, 3) colours, 0 to 255, that the views agree on, one view being read at a time; NaN where none is asked."""
    scratch, cameras, sampled = Scratch(), scene.cameras, []
    for n, view in enumerate(scene.views):
        chosen = np.flatnonzero(seen[n])
        samples = Samples(np.empty((len(chosen), 3)), np.empty(len(chosen)))
        sample_view(vertices, chosen, cameras.at(n), view.image, trusted_pixels(caster, view).trust, samples)
        sampled.append(scratch.keep(_Sampled(*samples)))
    colors = np.full((seen.shape[1], 3), np.nan)
    starts = np.zeros(len(sampled), np.int64)
    for first in range(0, len(colors), _BATCH):
        batch = seen[:, first : first + _BATCH]
        counts = batch.sum(axis=1)
        shown, weights = np.zeros((*batch.shape, 3)), np.zeros(batch.shape)
        for n, each in enumerate(sampled):
            found, own = each.read(), np.s_[starts[n] : starts[n] + counts[n]]
            shown[n, batch[n]], weights[n, batch[n]] = found.colors[own], found.weights[own]
        agreed_colors(shown, weights, colors[first : first + _BATCH])
        starts += counts
    return colors


def let_flow(
    colors: NDArray[np.float64], known: NDArray[np.bool_], points: NDArray[np.float64], triangles: NDArray[np.int32]
) -> None:
    """Fill in the unknown (n,) of (n, 3) colours: those of the nearest known in space, smoothed along the surface."""
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
