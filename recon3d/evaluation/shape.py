"""Connectedness, holes and smoothness of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from recon3d.errors import ArgumentError

_BLOCK = 1 << 18  # edges at a time, of some hundred bytes each


@dataclass(frozen=True)
class ShapeQuality:
    """Connectedness, holes and smoothness of a mesh whose triangles share their vertices.

    Triangles hang together by edges: where they touch in a vertex alone the mesh is taken as cut apart, so pieces that
    touch so are two, and holes that touch so are one.
    """

    components: int
    """Pieces; all but the largest by area are floating. The wall of an enclosed hollow is a piece of its own."""
    floating_share: float
    """Share of the area in floating pieces, in [0, 1)."""
    boundary_loops: int
    """Closed chains of edges with one triangle: holes in the surface, each open piece's rim included."""
    genus: int | None
    """Handles of the closed pieces together, sum of 1 - (V - E + F) / 2 (Euler, Poincare); None where none is closed.

    A piece is closed when each of its edges has two triangles.
    """
    nonmanifold_edges: int
    """Edges with more than two triangles."""
    nonmanifold_vertices: int
    """Vertices whose triangles form more than one fan."""
    dihedral_degrees: float
    """Mean angle between the normals of the two triangles at an edge, weighted by the edges' lengths; flat is 0.

    Shrinks with the triangles on one and the same smooth surface: compare meshes of equal voxels.
    """

    @classmethod
    def of(cls, mesh: o3d.geometry.TriangleMesh) -> ShapeQuality:
        """Measure a mesh.

        Raises
        ------
        ArgumentError : it has no triangles.
        """
        triangles = np.asarray(mesh.triangles)
        if not len(triangles):
            raise ArgumentError("the mesh to measure has no triangles")
        edges = _Edges.of(triangles)
        fan, n_fans = edges.fans()
        piece_of_fan, n_pieces = _connected(n_fans, fan[edges.ends])
        fans_of_vertex = np.bincount(triangles.ravel()[np.unique(fan, return_index=True)[1]])
        rim, of_rim = np.unique(fan[edges.ends[edges.sizes[edges.edge] == 1]], return_inverse=True)

        corners = np.asarray(mesh.vertices)[triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.bincount(piece_of_fan[fan[::3]], weights=np.linalg.norm(normals, axis=1), minlength=n_pieces)
        return cls(
            components=n_pieces,
            floating_share=float(1 - area.max() / area.sum()) if area.any() else 0.0,
            boundary_loops=_connected(len(rim), of_rim.reshape(-1, 2))[1],
            genus=_genus(edges, fan, piece_of_fan),
            nonmanifold_edges=int(np.count_nonzero(edges.sizes > 2)),
            nonmanifold_vertices=int(np.count_nonzero(fans_of_vertex > 1)),
            dihedral_degrees=_mean_dihedral(edges, corners.reshape(-1, 3), normals),
        )


@dataclass(frozen=True)
class _Edges:
    """The sides of a mesh's triangles, those of one edge next to each other.

    Corner 3 t + k is triangle t's k-th; a side's two ends are corners.
    """

    ends: NDArray[np.int32]
    """(3 n_triangles, 2) corners at the edge's vertex of lower and of higher index."""
    edge: NDArray[np.int32]
    """(3 n_triangles,) edge of each side, ascending."""
    sizes: NDArray[np.int64]
    """(n_edges,) triangles at each edge."""

    @classmethod
    def of(cls, triangles: NDArray[np.int32]) -> _Edges:
        """Sort the sides of triangles (n_triangles, 3) by their vertices."""
        corner = np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)
        ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
        low, high = triangles.ravel()[ends].T
        ends[low >= high] = ends[low >= high, ::-1]
        key = np.minimum(low, high) * (np.int64(triangles.max()) + 1) + np.maximum(low, high)
        order = np.argsort(key, kind="stable")
        edge = np.cumsum(np.diff(key[order], prepend=-1) != 0, dtype=np.int32) - np.int32(1)
        return cls(ends[order], edge, np.bincount(edge))

    def fans(self) -> tuple[NDArray[np.int32], int]:
        """(3 n_triangles,) number of the fan that each corner is in, and how many there are.

        A fan: the triangles at a vertex that edges at this vertex join.
        """
        same = np.flatnonzero(self.edge[1:] == self.edge[:-1])
        links = np.stack([self.ends[same], self.ends[same + 1]], axis=-1).reshape(-1, 2)
        return _connected(self.ends.shape[0], links)

    def pairs(self) -> NDArray[np.int64]:
        """(n,) first of the two neighbouring sides of each edge with two triangles."""
        return np.flatnonzero(self.sizes[self.edge] == 2)[::2]


def _connected(n_nodes: int, links: NDArray[np.integer]) -> tuple[NDArray[np.int32], int]:
    """(n_nodes,) component of each node under links (n, 2), and the number of components."""
    if not n_nodes:
        return np.empty(0, np.int32), 0
    graph = coo_array((np.ones(len(links), np.bool_), links.T), shape=(n_nodes, n_nodes))
    count, component = connected_components(graph, directed=False)
    return np.asarray(component, np.int32), int(count)


def _genus(edges: _Edges, fan: NDArray[np.int32], piece_of_fan: NDArray[np.int32]) -> int | None:
    """Handles of the closed pieces together, vertices of several fans counting once for each."""
    of_edge = piece_of_fan[fan[edges.ends[np.diff(edges.edge, prepend=-1) != 0, 0]]]
    n_vertices, n_edges = np.bincount(piece_of_fan), np.bincount(of_edge)
    n_triangles = np.bincount(piece_of_fan[fan[::3]])
    closed = np.bincount(of_edge, weights=edges.sizes != 2) == 0
    characteristic = (n_vertices - n_edges + n_triangles)[closed]
    return int((2 - characteristic).sum() // 2) if closed.any() else None


def _mean_dihedral(edges: _Edges, corners: NDArray[np.float64], normals: NDArray[np.float64]) -> float:
    """Degrees, weighted by length; triangles without area have no normal and are left out; 0 without an edge."""
    sides = edges.pairs()
    turned = total = 0.0
    for first in range(0, len(sides), _BLOCK):
        side = sides[first : first + _BLOCK]
        a, b = (normals[edges.ends[n, 0] // 3] for n in (side, side + 1))
        length = np.linalg.norm(np.subtract(*(corners[edges.ends[side, end]] for end in range(2))), axis=1)
        length *= a.any(axis=1) & b.any(axis=1)
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        turned, total = turned + float(angle @ length), total + float(length.sum())
    return float(np.degrees(turned / total)) if total else 0.0
