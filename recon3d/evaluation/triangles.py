"""Distances of points to a mesh's triangles, by Open3D's KD-tree."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.kernels.triangles import nearest_of
from recon3d.kernels.types import Nearest

_TOLERANCE = 0.01  # of each distance

_WIDE = 0.75  # of the largest reach

_THIN = 0.35  # height over longest edge; an equilateral triangle has 0.87

_LEAST = np.finfo(np.float64).tiny  # Open3D takes no radius of zero

_POINTS = 1024  # at once

_CANDIDATES = 1 << 20  # at once, about


def nearest_triangles(points: NDArray[np.float64], mesh: o3d.geometry.TriangleMesh) -> Nearest:
    """Distances of points (n, 3) to a mesh, and the triangles that they are to, right to 1% of each distance.

    Samples cover the mesh: no point of a triangle lies farther from one of its samples than their reach. The triangle
    of the nearest sample bounds the distance of a point, and a triangle that is nearer has a sample within the bound
    and the reach. So no triangle is missed, however few samples it has. Points far off need few candidates, since the
    tolerance exceeds the reach.
    """
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    samples, owners, reach = covering_samples(corners, len(corners) + len(points))
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor.from_numpy(samples))
    search.multi_radius_index()  # which serves both searches
    nearest = Nearest(np.full(len(points), np.inf), np.zeros(len(points), np.int64))
    first, size = 0, 64
    while first < len(points):
        part = slice(first, first + size)
        here, found = np.ascontiguousarray(points[part]), Nearest(nearest.squared[part], nearest.triangle[part])
        query = o3d.core.Tensor.from_numpy(here)
        index = search.knn_search(query, 1)[0].numpy().ravel()
        nearest_of(here, corners, owners[index], np.arange(len(here) + 1), found)
        radii = np.maximum((1 - _TOLERANCE) * np.sqrt(found.squared) + reach, _LEAST)
        index, _, starts = (x.numpy() for x in search.multi_radius_search(query, o3d.core.Tensor.from_numpy(radii)))
        nearest_of(here, corners, owners[index], starts, found)
        first += size
        size = min(_POINTS, _CANDIDATES * len(here) // max(len(index), 1) + 1)
    return nearest


def covering_samples(corners: NDArray[np.float64], most: int) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
    """Samples (n, 3) of triangles (n_triangles, 3, 3), the triangle (n,) that each lies on, and their reach.

    They are the centroids of the pieces that triangles are cut into, and the reach is the largest distance of a piece's
    corner from its centroid. Each triangle has a sample; the widest pieces are cut while there are ``most`` at most.
    """
    pieces, owners, reach = corners, np.arange(len(corners)), _reach(corners)
    while (wide := reach > _WIDE * reach.max()).any():
        cut, whose = _cut(pieces[wide])
        if len(pieces) - np.count_nonzero(wide) + len(cut) > most:
            break
        pieces = np.concatenate([pieces[~wide], cut])
        owners = np.concatenate([owners[~wide], owners[wide][whose]])
        reach = np.concatenate([reach[~wide], _reach(cut)])
    return pieces.mean(axis=1), owners, float(reach.max())


def _reach(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance of the farthest corner of triangles (n, 3, 3) from their centroid."""
    return np.asarray(np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max(axis=1))


def _cut(triangles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangles (n, 3, 3) cut in four between the middles of their edges, thin ones in two across the longest edge.

    Returns the pieces (m, 3, 3), and which triangle (m,) each comes from.
    """
    edges = np.roll(triangles, -1, axis=1) - triangles
    lengths = np.linalg.norm(edges, axis=2)
    double_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    thin = double_area < _THIN * lengths.max(axis=1) ** 2
    turned = (lengths[thin].argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles[thin], turned[..., None], axis=1).swapaxes(0, 1)
    ab = (a + b) / 2
    halves = [(a, ab, c), (ab, b, c)]
    a, b, c = triangles[~thin].swapaxes(0, 1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    whose = [np.flatnonzero(thin)] * 2 + [np.flatnonzero(~thin)] * 4
    return np.concatenate([np.stack(piece, axis=1) for piece in halves + quarters]), np.concatenate(whose)
