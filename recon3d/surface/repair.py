"""Meshes made clean: no small components, every edge and vertex manifold, every closed piece the right side out."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from recon3d.errors import ArgumentError
from recon3d.rendering.ray_caster import RayCaster

_DIRECTIONS = np.array([[0.54, 0.32, 0.78], [-0.83, 0.47, 0.31], [0.23, -0.71, -0.67]])  # none along a lattice


@dataclass(frozen=True)
class Repairs:
    """What was wrong with a mesh, and is no longer."""

    small_components: int = 0
    """Pieces that were dropped because they are small."""
    non_manifold_edges: int = 0
    """Edges cut because more than two triangles met there, or two that disagree which side is out."""
    non_manifold_vertices: int = 0
    """Vertices doubled because the triangles around them did not hang together."""
    inward_pieces: int = 0
    """Closed pieces turned because their triangles faced inwards."""

    def __add__(self, other: Repairs) -> Repairs:
        """Both counts together."""
        return Repairs(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))

    def record(self) -> dict[str, int]:
        """The counts by name."""
        return asdict(self)

    def __str__(self) -> str:
        """What was not in order, in one line; empty when everything was."""
        told = {
            "small components dropped": self.small_components,
            "non-manifold edges cut": self.non_manifold_edges,
            "non-manifold vertices doubled": self.non_manifold_vertices,
            "pieces turned outwards": self.inward_pieces,
        }
        return ", ".join(f"{count:,} {what}" for what, count in told.items() if count)


class Repaired(NamedTuple):
    """A mesh in order."""

    mesh: o3d.geometry.TriangleMesh
    repairs: Repairs
    source: NDArray[np.int64]
    """(n_vertices,) the vertex of the given mesh that each vertex is a copy of."""


def repair_mesh(
    mesh: o3d.geometry.TriangleMesh, *, kept: NDArray[np.bool_] | None = None, min_area: float = 0.0
) -> Repaired:
    """The mesh with manifold edges and vertices, without small components, its closed pieces the right side out.

    Where triangles meet at an edge or a vertex without forming one sheet, the sheets are cut apart: their vertices
    are doubled and stay where they are, so the surface does not move. A closed piece faces outwards where an even
    number of others encloses it, into the cavity where an odd number does.

    Parameters
    ----------
    mesh : vertices that no triangle uses are left out.
    kept : (n_vertices,) triangles with a vertex that is not kept are cut away first; at least one must be left. All
        are kept when None.
    min_area : connected pieces of a smaller area, in square world units, are dropped; the largest stays.

    References
    ----------
    Gueziec, Taubin, Lazarus, Horn, "Cutting and stitching: converting sets of polygons to manifold surfaces", IEEE
    Transactions on Visualization and Computer Graphics 2001 (cutting through the corners' connectivity).
    """
    given = np.asarray(mesh.triangles)
    triangles = given if kept is None else given[kept[given].all(axis=1)]
    if not len(triangles):
        raise ArgumentError(f"expected a mesh with a triangle to keep, got none of {len(given):,}")
    first, second, crowded = _neighbouring_corners(triangles)
    sheet = _components(first, second, triangles.size)
    source = np.empty(sheet.max() + 1, np.int64)
    source[sheet] = triangles.ravel()
    n_doubled = int((np.bincount(source) > 1).sum())
    corners = sheet.reshape(-1, 3)
    small, n_small = _small_pieces(np.asarray(mesh.vertices)[source], corners, min_area)
    corners = corners[~small]
    used = np.unique(corners)
    used = used[np.argsort(source[used], kind="stable")]  # in the given mesh's order
    rank = np.empty(len(source), np.int64)
    rank[used] = np.arange(len(used))
    source = source[used]
    sound = _rebuilt(mesh, source, rank[corners])
    inward, n_inward = _inward(sound)
    if n_inward:
        turned = np.asarray(sound.triangles).copy()
        turned[inward] = turned[inward][:, ::-1]
        sound.triangles = o3d.utility.Vector3iVector(turned)
    if mesh.has_vertex_normals() and (n_inward or n_doubled):
        sound.compute_vertex_normals()
    return Repaired(sound, Repairs(n_small, crowded, n_doubled, n_inward), source)


def _small_pieces(
    points: NDArray[np.float64], triangles: NDArray[np.int32], min_area: float
) -> tuple[NDArray[np.bool_], int]:
    """(n_triangles,) which belong to pieces of a smaller area that are not the largest, and how many these are."""
    piece = _pieces(triangles)
    areas = np.bincount(piece, triangle_areas(points, triangles))
    small = areas < min_area
    small[areas.argmax()] = False
    return small[piece], int(small.sum())


def triangle_areas(points: NDArray[np.float64], triangles: NDArray[np.integer]) -> NDArray[np.float64]:
    """(n_triangles,) areas of triangles (n_triangles, 3) over points (n, 3)."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _neighbouring_corners(triangles: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32], int]:
    """Pairs of corners (n,), (n,) that two triangles have in common at a manifold edge; how many edges are not.

    Corner k of triangle t is number 3 t + k.
    """
    corner = np.arange(triangles.size, dtype=np.int32).reshape(-1, 3)
    start, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    a, b = triangles.ravel()[start], triangles.ravel()[end]
    key = np.minimum(a, b) * (np.int64(triangles.max()) + 1) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    length = np.diff(begins, append=len(key))
    pair = begins[length == 2]
    one, other = order[pair], order[pair + 1]
    agree = a[one] == b[other]  # they run through the edge in opposite directions
    one, other = one[agree], other[agree]
    crowded = int((length > 2).sum() + (~agree).sum())
    return np.concatenate([start[one], end[one]]), np.concatenate([end[other], start[other]]), crowded


def _inward(mesh: o3d.geometry.TriangleMesh) -> tuple[NDArray[np.bool_], int]:
    """(n_triangles,) which belong to closed pieces that are inside out, and how many pieces these are."""
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    piece = _pieces(triangles)
    n_pieces = int(piece.max()) + 1
    volumes = _volumes(points - points.mean(axis=0), triangles, piece, n_pieces)
    closed = _closed(triangles, piece, n_pieces)
    enclosed = _enclosed(mesh, piece, n_pieces) if n_pieces > 1 else np.zeros(n_pieces, np.bool_)
    wrong = closed & ((volumes < 0) != enclosed)
    return wrong[piece], int(wrong.sum())


def _volumes(
    points: NDArray[np.float64], triangles: NDArray[np.int32], piece: NDArray[np.int64], n_pieces: int
) -> NDArray[np.float64]:
    """(n_pieces,) six times the signed volume of each."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.asarray(np.bincount(piece, np.einsum("ij,ij->i", a, np.cross(b, c)), n_pieces), np.float64)


def _closed(triangles: NDArray[np.int32], piece: NDArray[np.int64], n_pieces: int) -> NDArray[np.bool_]:
    """(n_pieces,) whether every edge of a piece has more than one triangle."""
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    key = np.minimum(a, b) * (np.int64(triangles.max()) + 1) + np.maximum(a, b)
    _, owner, uses = np.unique(key, return_index=True, return_counts=True)
    closed = np.ones(n_pieces, np.bool_)
    closed[piece[owner[uses == 1] // 3]] = False
    return closed


def _enclosed(mesh: o3d.geometry.TriangleMesh, piece: NDArray[np.int64], n_pieces: int) -> NDArray[np.bool_]:
    """(n_pieces,) whether an odd number of other pieces encloses each; where pieces touch, the majority of three rays.

    Beyond its outermost vertex in some direction, a ray in that direction does not meet the piece again.
    """
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    caster = RayCaster(mesh)
    beyond = 1e-5 * float(np.linalg.norm(np.ptp(points, axis=0)))
    votes = np.zeros(n_pieces, np.int64)
    for direction in _DIRECTIONS:
        order = np.lexsort([(points @ direction)[triangles].max(axis=1), piece])
        last = order[np.searchsorted(piece[order], np.arange(n_pieces), side="right") - 1]
        corners = points[triangles[last]]
        top = corners[np.arange(n_pieces), (corners @ direction).argmax(axis=1)]
        votes += caster.crossings(top + beyond * direction, direction) % 2
    return np.asarray(2 * votes > len(_DIRECTIONS))


def _rebuilt(
    mesh: o3d.geometry.TriangleMesh, source: NDArray[np.int64], triangles: NDArray[np.int64]
) -> o3d.geometry.TriangleMesh:
    """Mesh of triangles over vertices that are copies of others (n,), with their colours and normals."""
    rebuilt = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(mesh.vertices)[source]),
        o3d.utility.Vector3iVector(triangles.astype(np.int32)),
    )
    if mesh.has_vertex_colors():
        rebuilt.vertex_colors = o3d.utility.Vector3dVector(np.asarray(mesh.vertex_colors)[source])
    if mesh.has_vertex_normals():
        rebuilt.vertex_normals = o3d.utility.Vector3dVector(np.asarray(mesh.vertex_normals)[source])
    return rebuilt


def _pieces(triangles: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n,) number of the connected piece that each triangle (n, 3) belongs to."""
    of_points = _components(triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel(), int(triangles.max()) + 1)
    return np.unique(of_points[triangles[:, 0]], return_inverse=True)[1]


def _components(first: NDArray[np.integer], second: NDArray[np.integer], n: int) -> NDArray[np.int32]:
    """(n,) number of the component of each of n nodes under links first to second."""
    links = coo_array((np.ones(len(first), np.bool_), (first, second)), shape=(n, n))
    return np.asarray(connected_components(links, directed=False)[1], np.int32)
