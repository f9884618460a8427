"""From oriented points to a closed mesh, and which of it the points support."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.surface.extraction import blend_colors, mesh_shape
from recon3d.surface.graph_cut import graph_cut
from recon3d.volume.carved import CarvedVolume

Surface = Literal["poisson", "graph-cut"]
"""Screened Poisson reconstruction, or the minimum cut of the carved volume."""


_REACH = 2.0  # spacings from a point within which the surface is measured


_MARGIN = 1.1  # of Poisson's cube around the points


def mesh_points(
    points: o3d.t.geometry.PointCloud, hull: CarvedVolume, *, surface: Surface = "poisson", spacing: float | None = None
) -> o3d.geometry.TriangleMesh:
    """Closed mesh through oriented points; where there are none, the hull closes it, or a small surface inside it.

    Parameters
    ----------
    points : as ``refine`` finds them.
    hull : what is left of the carved volume in their places, as ``refine`` leaves it.
    surface : "poisson" follows the points most closely, and the hull where there are none; "graph-cut" is edge-manifold
        by construction and holds its own against outliers, but where there are none takes the shortest way inside the
        hull.
    spacing : finest detail that Poisson resolves, and half the distance from the nearest point beyond which the hull
        takes over, world units; half a voxel when None.

    Returns
    -------
    TriangleMesh
        With vertex normals outwards, and the nearest points' colours.

    Raises
    ------
    EmptyReconstructionError : no voxel or no point lies in the hull.

    References
    ----------
    Kazhdan, Hoppe, "Screened Poisson surface reconstruction", ACM Transactions on Graphics 2013.
    """
    if surface not in get_args(Surface):
        raise ValueError(f"expected surface {', '.join(get_args(Surface))}, got {surface!r}")
    if spacing is not None and not 0 < spacing < np.inf:
        raise ValueError(f"expected a positive spacing, got {spacing}")
    if surface == "graph-cut":
        return graph_cut(points, hull)
    spacing = spacing or hull.volume.voxel_size / 2
    closed = _closed_by_hull(points, hull, spacing)
    extent = float(max(closed.get_max_bound() - closed.get_min_bound()))
    depth = max(round(np.log2(_MARGIN * extent / spacing)), 1)
    # Poisson computes in single precision, so far from the origin it would lose the surface; on more threads than one,
    # which are hardly faster, its vertices come in another order every time.
    middle = closed.get_axis_aligned_bounding_box().get_center()
    closed.translate(-middle)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(closed, depth=depth, scale=_MARGIN, n_threads=1)
    mesh.translate(middle)
    mesh.compute_vertex_normals()
    positions, colors = points.point.positions.numpy(), points.point.colors.numpy()
    blended = blend_colors(positions, np.rint(255 * colors).astype(np.uint8), spacing, np.asarray(mesh.vertices))
    mesh.vertex_colors = o3d.utility.Vector3dVector(blended)
    return mesh


def near_points(places: NDArray[np.float64], points: o3d.t.geometry.PointCloud, spacing: float) -> NDArray[np.bool_]:
    """(n,) which world positions (n, 3) lie near enough to a point to be measured: within two spacings."""
    tree = cKDTree(points.point.positions.numpy())
    distance, _ = tree.query(places, distance_upper_bound=_REACH * spacing, workers=-1)
    return np.asarray(np.isfinite(distance))


def _closed_by_hull(points: o3d.t.geometry.PointCloud, hull: CarvedVolume, spacing: float) -> o3d.geometry.PointCloud:
    """The points, and the hull's surface where it lies far from all of them."""
    shell = mesh_shape(hull.with_interior, distance=hull.distance)
    vertices = np.asarray(shell.vertices)
    gap = ~near_points(vertices, points, spacing)
    cloud = o3d.geometry.PointCloud(
        o3d.utility.Vector3dVector(np.concatenate([points.point.positions.numpy(), vertices[gap]]))
    )
    cloud.normals = o3d.utility.Vector3dVector(
        np.concatenate([points.point.normals.numpy(), np.asarray(shell.vertex_normals)[gap]])
    )
    return cloud
