"""From oriented points to a closed mesh, and where the points measured it."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.errors import ArgumentError
from recon3d.heap import give_back
from recon3d.rendering.ray_caster import power_of_two
from recon3d.surface.extraction import mesh_shape
from recon3d.surface.minimum_cut import graph_cut
from recon3d.volume.carved import CarvedVolume

Surface = Literal["poisson", "graph-cut"]
"""Screened Poisson reconstruction, or the minimum cut of the carved volume."""


_REACH = 2.0  # spacings from a point within which the surface is measured


_FACING = 0.5  # cosine of the largest angle between a measured surface's normal and the nearest point's


_MARGIN = 1.1  # of Poisson's cube around the points


class MeasuredSpace:
    """Where the surface is measured: within two spacings of a point.

    Parameters
    ----------
    points : with ``positions`` (n, 3), world units, and ``normals`` (n, 3), unit, if surfaces are asked for.
    spacing : between points, world units.
    """

    def __init__(self, points: o3d.t.geometry.PointCloud, spacing: float) -> None:
        self._tree, self._points = cKDTree(points.point.positions.numpy()), points
        self._reach = _REACH * spacing

    def holds(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) which world positions (n, 3) lie in it."""
        distance, _ = self._tree.query(places, distance_upper_bound=self._reach, workers=-1)
        return np.asarray(np.isfinite(distance))

    def holds_surface(self, mesh: o3d.geometry.TriangleMesh) -> NDArray[np.bool_]:
        """(n_vertices,) which vertices lie in it and face where the nearest point does.

        What closes a mesh turns away from the points at their rim. The mesh has vertex normals.
        """
        distance, nearest = self._tree.query(np.asarray(mesh.vertices), distance_upper_bound=self._reach, workers=-1)
        measured: NDArray[np.bool_] = np.isfinite(distance)
        normals = self._points.point.normals.numpy()[nearest[measured]]
        measured[measured] = np.einsum("ij,ij->i", normals, np.asarray(mesh.vertex_normals)[measured]) > _FACING
        return measured


def mesh_points(
    points: o3d.t.geometry.PointCloud,
    hull: CarvedVolume,
    *,
    surface: Surface = "poisson",
    spacing: float | None = None,
    measured: MeasuredSpace | None = None,
) -> o3d.geometry.TriangleMesh:
    """Closed mesh through oriented points; unmeasured regions are filled from the hull or inside it.

    Parameters
    ----------
    points : as ``refine`` finds them.
    hull : what is left of the carved volume in their places, as ``refine`` leaves it.
    surface : "poisson" follows the points most closely, and the hull where there are none; "graph-cut" is edge-manifold
        by construction and holds its own against outliers, but where there are none takes the shortest way inside the
        hull.
    spacing : finest detail that Poisson resolves, and half the distance from the nearest point beyond which the hull
        takes over, world units; half a voxel when None.
    measured : where the points measured the surface, where that is known already.

    Returns
    -------
    TriangleMesh
        Without colours, vertex normals outwards.

    Raises
    ------
    EmptyReconstructionError : no voxel or no point lies in the hull.

    References
    ----------
    Kazhdan, Hoppe, "Screened Poisson surface reconstruction", ACM Transactions on Graphics 2013.
    """
    if surface not in get_args(Surface):
        raise ArgumentError(f"expected surface {', '.join(get_args(Surface))}, got {surface!r}")
    if spacing is not None and not 0 < spacing < np.inf:
        raise ArgumentError(f"expected a positive spacing, got {spacing}")
    if surface == "graph-cut":
        return graph_cut(points, hull)
    spacing = spacing or hull.volume.voxel_size / 2
    closed = _closed_by_hull(points, hull, measured or MeasuredSpace(points, spacing))
    extent = float(max(closed.get_max_bound() - closed.get_min_bound()))
    depth = octree_depth(extent, spacing)
    # Poisson computes in single precision, so far from the origin it would lose the surface, and in an odd unit digits;
    # on more threads than one, which are hardly faster, its vertices come in another order every time.
    middle, unit = closed.get_axis_aligned_bounding_box().get_center(), power_of_two(spacing)
    closed.translate(-middle)
    closed.scale(1 / unit, np.zeros(3))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(closed, depth=depth, scale=_MARGIN, n_threads=1)
    give_back()  # the octree
    mesh.vertex_colors = o3d.utility.Vector3dVector()  # black ones
    mesh.compute_vertex_normals()
    mesh.scale(unit, np.zeros(3))
    mesh.translate(middle)
    return mesh


def octree_depth(extent: float, spacing: float) -> int:
    """Depth of the octree around something of an extent whose cells are about as large as a spacing."""
    return max(round(float(np.log2(_MARGIN * extent / spacing))), 1)


def _closed_by_hull(
    points: o3d.t.geometry.PointCloud, hull: CarvedVolume, measured: MeasuredSpace
) -> o3d.geometry.PointCloud:
    """The points, and the hull's surface where it lies far from all of them."""
    shell = mesh_shape(hull.with_interior, distance=hull.distance)
    vertices = np.asarray(shell.vertices)
    gap = ~measured.holds(vertices)
    cloud = o3d.geometry.PointCloud(
        o3d.utility.Vector3dVector(np.concatenate([points.point.positions.numpy(), vertices[gap]]))
    )
    cloud.normals = o3d.utility.Vector3dVector(
        np.concatenate([points.point.normals.numpy(), np.asarray(shell.vertex_normals)[gap]])
    )
    return cloud
