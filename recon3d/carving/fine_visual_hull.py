"""The visual hull from coarse to fine: bricks first, then the voxels of those that the surface crosses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.bricks import BrickItems, Bricks, whole_lattice
from recon3d.carving.method import Method
from recon3d.carving.observer import Observer
from recon3d.carving.start import nothing_inside, silhouette_outlines
from recon3d.carving.visual_hull import VisualHull
from recon3d.checks import require_whole
from recon3d.kernels.bricks import BRICK, UNDECIDED
from recon3d.kernels.silhouettes import bound_bricks, sample_bricks
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import BAND, Lattice
from recon3d.volume.sparse import SparseVolume


@dataclass(frozen=True)
class FineVisualHull(Method):
    """Intersect the silhouettes' cones on a fine lattice, in memory and time that grow with the surface.

    The same voxels, distances and colours as those of ``VisualHull``. A brick whose projections keep clear of every
    outline is empty or solid at once; the others are sampled at every voxel, and those that come within 3 voxels of
    the surface are stored.

    References
    ----------
    Laurentini, "The visual hull concept for silhouette-based image understanding", PAMI 1994.
    Szeliski, "Rapid octree construction from image sequences", CVGIP 1993 (coarse to fine).
    """

    needs_silhouettes: ClassVar[bool] = True

    tolerance: int = 0
    """Silhouettes that may be wrong about a voxel; k out of n exclude it only if k > tolerance."""

    def __post_init__(self) -> None:
        require_whole("tolerance", self.tolerance, least=0)

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,  # noqa: ARG002 # no verdicts are made
    ) -> SparseVolume:
        """Keep the voxels of a lattice that are inside.

        Raises
        ------
        ArgumentError : a volume that is not full, or as many silhouettes may be wrong as there are.
        SceneError : no view has a silhouette.
        VolumeTooLargeError : the bricks near the surface would not fit into the memory that is free now.
        EmptyReconstructionError : nothing is inside; names the view that excludes most.
        """
        report = progress or (lambda _done, _total: None)
        bricks = hull_bricks(scene, whole_lattice(volume), tolerance=self.tolerance)
        report(1, 2)
        hull = bricks.colored(BrickItems(scene.packed, bricks))
        report(2, 2)
        return hull

    def dense(self) -> VisualHull:
        """The method that leaves the same voxels with all of them stored."""
        return VisualHull(self.tolerance)


def hull_bricks(scene: Scene, lattice: Lattice, *, tolerance: int = 0) -> Bricks:
    """Visual hull in bricks, with the distance to it."""
    outlines = silhouette_outlines(scene, tolerance)
    hull = Bricks(lattice)
    place, limit = lattice.packed, BAND * lattice.voxel_size

    slots = hull.slots
    bound_bricks(place, outlines, limit, slots)
    undecided = np.argwhere(slots == UNDECIDED)
    kinds = np.empty(len(undecided), np.int32)
    sample_bricks(undecided, place, outlines, limit, _no_field(0), kinds)
    slots[tuple(undecided.T)] = kinds

    stored = np.argwhere(slots == UNDECIDED)
    hull.require_memory(len(stored))
    field = _no_field(len(stored))
    sample_bricks(stored, place, outlines, limit, field, np.empty(len(stored), np.int32))
    slots[tuple(stored.T)] = np.arange(len(stored), dtype=np.int32)
    hull.place(slots, field)
    if not hull.n_occupied:
        raise nothing_inside(scene, lambda alone: hull_bricks(alone, lattice).n_occupied / lattice.n_voxels)
    return hull


def _no_field(n_bricks: int) -> NDArray[np.float32]:
    return np.empty((n_bricks, BRICK, BRICK, BRICK), np.float32)
