"""The visual hull: what all silhouettes have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.method import Method
from recon3d.carving.observer import Observer
from recon3d.carving.start import hull_distance
from recon3d.carving.visible import color_visible
from recon3d.checks import require_whole
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice


@dataclass(frozen=True)
class VisualHull(Method):
    """Intersect the silhouettes' cones, to a fraction of a voxel.

    A voxel is inside when the signed distance of its centre's projection to every silhouette's outline is positive.
    The distances are kept, so that the surface is smooth rather than stair-stepped. A view says nothing of what lies
    outside its image or behind it, nor one without silhouette.

    References
    ----------
    Laurentini, "The visual hull concept for silhouette-based image understanding", PAMI 1994.
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
    ) -> CarvedVolume:
        """Keep the voxels that are inside.

        Returns
        -------
        CarvedVolume
            Consistent: the voxels that some pixel sees, with the mean colour of its pixels; hidden: the others inside.

        Raises
        ------
        SceneError : no view has a silhouette.
        ArgumentError : as many silhouettes may be wrong as there are.
        EmptyReconstructionError : nothing is inside; names the view that excludes most.
        """
        volume = CarvingVolume.full(volume)
        field = hull_distance(scene, volume, tolerance=self.tolerance)
        views = scene.packed
        occupied = volume.occupied & (field > 0)
        hull = CarvedVolume.untouched(volume, field)
        hull.labels[volume.occupied] = np.where(occupied[volume.occupied], Label.HIDDEN, Label.BACKGROUND)
        color_visible(hull, ItemBuffer(views, volume), occupied)
        if progress:
            progress(1, 1)
        return hull
