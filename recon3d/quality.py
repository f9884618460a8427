"""How good a reconstruction is where no ground truth is known: by its own photographs, and by its shape."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from recon3d.html import Summarised
from recon3d.rendering import Renderer
from recon3d.scene import Scene, View

_PER_LEVEL = 10
"""Differences are counted in tenths of a grey level."""


@dataclass(frozen=True)
class Reprojection:
    """A coloured mesh rendered from the cameras of some views, against their photographs.

    Differences are absolute ones of luminance (ITU-R BT.601), in grey levels of 0 to 255, over the pixels that show
    the mesh and, where a silhouette is known, lie in it. What the mesh lacks is not among them: read the error together
    with the overlap.
    """

    counts: NDArray[np.int64]
    """(2551,) number of pixels with each difference, in tenths of a grey level."""
    intersection: int
    """Pixels that show the mesh and lie in the silhouette; 0 where no silhouette is known."""
    union: int
    """Pixels that show the mesh or lie in the silhouette; 0 where no silhouette is known."""

    @property
    def pixels(self) -> int:
        """How many pixels were compared."""
        return int(self.counts.sum())

    @property
    def median(self) -> float | None:
        """Half of the pixels differ by no more: unmoved by highlights and edges a pixel off; None without pixels."""
        if not self.pixels:
            return None
        return float(np.searchsorted(np.cumsum(self.counts), self.pixels / 2)) / _PER_LEVEL

    @property
    def mean(self) -> float | None:
        """Mean difference; None without pixels."""
        return self._moment(1)

    @property
    def rms(self) -> float | None:
        """Root mean square difference, which a few bad places rule; None without pixels."""
        square = self._moment(2)
        return None if square is None else float(np.sqrt(square))

    @property
    def overlap(self) -> float | None:
        """Intersection over union of rendered mask and silhouette, in [0, 1]; None where no silhouette is known."""
        return self.intersection / self.union if self.union else None

    def _moment(self, power: int) -> float | None:
        """Mean of a power of the differences."""
        levels = np.arange(len(self.counts)) / _PER_LEVEL
        return float(self.counts @ levels**power) / self.pixels if self.pixels else None

    def record(self) -> dict[str, object]:
        """The figures for a JSON file."""
        names = ("pixels", "median", "mean", "rms", "overlap")
        return {name: getattr(self, name) for name in names}


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
        ValueError : it has no triangles.
        """
        triangles = np.asarray(mesh.triangles, np.int64)
        if not len(triangles):
            raise ValueError("the mesh to measure has no triangles")
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


@dataclass(frozen=True, repr=False)
class Quality(Summarised):
    """What photographs and shape say of a mesh."""

    views: dict[str, Reprojection]
    """Of each view, by its name."""
    shape: ShapeQuality

    @property
    def overall(self) -> Reprojection:
        """All views together, every pixel counting the same."""
        of_views = self.views.values()
        return Reprojection(
            np.sum([view.counts for view in of_views], axis=0),
            sum(view.intersection for view in of_views),
            sum(view.union for view in of_views),
        )

    def summary(self) -> dict[str, object]:
        """Table of the figures."""
        overall, shape = self.overall, self.shape
        error = "not coloured, or nowhere in view"
        if overall.pixels:
            error = f"median {overall.median:.1f}, mean {overall.mean:.1f}, RMS {overall.rms:.1f} grey levels"
        overlap = "" if overall.overlap is None else f"; silhouette overlap {100 * overall.overlap:.1f}%"
        genus = "" if shape.genus is None else f", genus {shape.genus}"
        return {
            f"re-projection ({len(self.views)} views)": f"{error}{overlap}",
            "shape": f"{shape.components - 1:,} floating pieces ({100 * shape.floating_share:.2g}% of the area), "
            f"{shape.boundary_loops:,} open rims{genus}, {shape.nonmanifold_edges:,} non-manifold edges, "
            f"{shape.dihedral_degrees:.1f} degrees between neighbouring triangles",
        }

    def record(self) -> dict[str, object]:
        """The figures for a JSON file."""
        return {
            "reprojection": self.overall.record(),
            "views": {name: view.record() for name, view in self.views.items()},
            "shape": asdict(self.shape),
        }


def measure_quality(mesh: o3d.geometry.TriangleMesh, scene: Scene, *, max_pixels: int = 500_000) -> Quality:
    """Measure a coloured mesh by a scene's photographs and silhouettes, and by its own shape.

    Views that the reconstruction has not used show how it generalises. Rays go through the centres of pixels, so a
    photograph's blur over a pixel counts as error where the mesh has an edge.

    Parameters
    ----------
    mesh : in the scene's frame; without vertex colours nothing is compared with the photographs.
    max_pixels : of all photographs together; of larger ones every second, third, ... row and column is taken, which
        are pixels as they are, not averages.

    Raises
    ------
    ValueError : the mesh has no triangles, or ``max_pixels`` is below 1.
    """
    if max_pixels < 1:
        raise ValueError(f"expected max_pixels of at least 1, got {max_pixels}")
    shape = ShapeQuality.of(mesh)
    total = sum(view.width * view.height for view in scene.views)
    step = int(np.ceil(np.sqrt(total / max_pixels)))
    renderer = Renderer(mesh)
    colored = mesh.has_vertex_colors()
    return Quality({view.name: _compare(renderer, view, step, colored=colored) for view in scene.views}, shape)


def _compare(renderer: Renderer, view: View, step: int, *, colored: bool) -> Reprojection:
    """Rendered against photographed, at every step-th row and column."""
    start = (step - 1) // 2
    # Pixel u of the coarse camera is pixel start + step * u of the view.
    coarse = np.array([[step, 0, start], [0, step, start], [0, 0, 1.0]])
    taken = np.s_[start::step, start::step]
    photograph = view.image[taken]
    height, width = photograph.shape[:2]
    rendering = renderer.render(np.linalg.inv(coarse) @ view.K, view.cam_from_world, width, height)

    compared, intersection, union = rendering.hit, 0, 0
    if view.silhouette is not None:
        silhouette = view.silhouette[taken]
        compared = rendering.hit & silhouette
        intersection, union = int(np.count_nonzero(compared)), int(np.count_nonzero(rendering.hit | silhouette))
    shown = (255 * rendering.colors[compared]).astype(np.float32) if colored else np.empty((0, 3), np.float32)
    seen = photograph[compared].astype(np.float32) if colored else shown
    difference = np.rint(_PER_LEVEL * np.abs(_luminance(shown) - _luminance(seen))).astype(np.int64)
    return Reprojection(np.bincount(difference, minlength=255 * _PER_LEVEL + 1), intersection, union)


def _luminance(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) of RGB colours (n, 3)."""
    return colors @ np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True)
class _Edges:
    """The sides of a mesh's triangles, those of one edge next to each other.

    Corner 3 t + k is triangle t's k-th; a side's two ends are corners.
    """

    ends: NDArray[np.int64]
    """(3 n_triangles, 2) corners at the edge's vertex of lower and of higher index."""
    edge: NDArray[np.int64]
    """(3 n_triangles,) edge of each side, ascending."""
    sizes: NDArray[np.int64]
    """(n_edges,) triangles at each edge."""

    @classmethod
    def of(cls, triangles: NDArray[np.int64]) -> _Edges:
        """Sort the sides of triangles (n_triangles, 3) by their vertices."""
        corner = np.arange(triangles.size).reshape(-1, 3)
        ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
        vertices = triangles.ravel()[ends]
        ends = np.where(vertices[:, :1] < vertices[:, 1:], ends, ends[:, ::-1])
        key = vertices.min(axis=1) * (triangles.max() + 1) + vertices.max(axis=1)
        order = np.argsort(key, kind="stable")
        edge = np.cumsum(np.diff(key[order], prepend=-1) != 0) - 1
        return cls(ends[order], edge, np.bincount(edge))

    def fans(self) -> tuple[NDArray[np.int64], int]:
        """(3 n_triangles,) number of the fan that each corner is in, and how many there are.

        A fan: the triangles at a vertex that edges at this vertex join.
        """
        same = np.flatnonzero(self.edge[1:] == self.edge[:-1])
        links = np.stack([self.ends[same], self.ends[same + 1]], axis=-1).reshape(-1, 2)
        return _connected(self.ends.shape[0], links)

    def pairs(self) -> NDArray[np.int64]:
        """(n,) first of the two neighbouring sides of each edge with two triangles."""
        return np.flatnonzero(self.sizes[self.edge] == 2)[::2]


def _connected(n_nodes: int, links: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """(n_nodes,) component of each node under links (n, 2), and the number of components."""
    if not n_nodes:
        return np.empty(0, np.int64), 0
    graph = coo_array((np.ones(len(links), np.bool_), links.T), shape=(n_nodes, n_nodes))
    count, component = connected_components(graph, directed=False)
    return component.astype(np.int64), int(count)


def _genus(edges: _Edges, fan: NDArray[np.int64], piece_of_fan: NDArray[np.int64]) -> int | None:
    """Handles of the closed pieces together, vertices of several fans counting once for each."""
    of_edge = piece_of_fan[fan[edges.ends[np.diff(edges.edge, prepend=-1) != 0, 0]]]
    n_vertices, n_edges = np.bincount(piece_of_fan), np.bincount(of_edge)
    n_triangles = np.bincount(piece_of_fan[fan[::3]])
    closed = np.bincount(of_edge, weights=edges.sizes != 2) == 0
    characteristic = (n_vertices - n_edges + n_triangles)[closed]
    return int((2 - characteristic).sum() // 2) if closed.any() else None


def _mean_dihedral(edges: _Edges, corners: NDArray[np.float64], normals: NDArray[np.float64]) -> float:
    """Degrees, weighted by length; triangles without area have no normal and are left out; 0 without an edge."""
    side = edges.pairs()
    a, b = (normals[edges.ends[n, 0] // 3] for n in (side, side + 1))
    length = np.linalg.norm(np.subtract(*(corners[edges.ends[side, end]] for end in range(2))), axis=1)
    length *= a.any(axis=1) & b.any(axis=1)
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
    return float(np.degrees(angle @ length / length.sum())) if length.any() else 0.0
