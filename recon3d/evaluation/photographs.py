"""How good a reconstruction is where no ground truth is known: by its own photographs, and by its shape."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.evaluation.shape import ShapeQuality
from recon3d.rendering.ray_caster import RayCaster
from recon3d.rendering.renderer import Renderer
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.summary import Summarised

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


def measure_quality(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, *, max_pixels: int = 500_000, caster: RayCaster | None = None
) -> Quality:
    """Measure a coloured mesh by a scene's photographs and silhouettes, and by its own shape.

    Views that the reconstruction has not used show how it generalises. Rays go through the centres of pixels, so a
    photograph's blur over a pixel counts as error where the mesh has an edge.

    Parameters
    ----------
    mesh : in the scene's frame; without vertex colours nothing is compared with the photographs.
    max_pixels : of all photographs together; of larger ones every second, third, ... row and column is taken, which
        are pixels as they are, not averages.
    caster : of the mesh, where there is one already.

    Raises
    ------
    ArgumentError : the mesh has no triangles, or ``max_pixels`` is below 1.
    """
    if max_pixels < 1:
        raise ArgumentError(f"expected max_pixels of at least 1, got {max_pixels}")
    shape = ShapeQuality.of(mesh)
    total = sum(view.width * view.height for view in scene.views)
    step = int(np.ceil(np.sqrt(total / max_pixels)))
    renderer = Renderer(mesh, caster)
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
    pixels = renderer.cast(np.linalg.inv(coarse) @ view.K, view.cam_from_world, width, height)

    hit = compared = pixels.hit
    intersection = union = 0
    whole = view.silhouette
    if whole is not None:
        silhouette = whole[taken]
        compared = hit & silhouette
        intersection, union = int(np.count_nonzero(compared)), int(np.count_nonzero(hit | silhouette))
    shown = (255 * renderer.colors(pixels)[compared]).astype(np.float32) if colored else np.empty((0, 3), np.float32)
    seen = photograph[compared].astype(np.float32) if colored else shown
    difference = np.rint(_PER_LEVEL * np.abs(_luminance(shown) - _luminance(seen))).astype(np.int64)
    return Reprojection(np.bincount(difference, minlength=255 * _PER_LEVEL + 1), intersection, union)


def _luminance(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) of RGB colours (n, 3)."""
    return colors @ np.array([0.299, 0.587, 0.114], np.float32)
