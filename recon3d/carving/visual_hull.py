"""The visual hull: what all silhouettes have in common."""

from __future__ import annotations

import numpy as np

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.start import hull_distance
from recon3d.carving.visible import color_visible
from recon3d.consistency.base import ConsistencyTest
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume


def visual_hull(
    scene: Scene,
    volume: CarvingVolume,
    test: ConsistencyTest | None = None,  # noqa: ARG001 # methods are called alike
    *,
    tolerance: int = 0,
    progress: Progress | None = None,
) -> CarvedVolume:
    """Intersect the silhouettes' cones, to a fraction of a voxel.

    A voxel is inside when the signed distance of its centre's projection to every silhouette's outline is positive.
    The distances are kept, so that the surface is smooth rather than stair-stepped. A view says nothing of what lies
    outside its image or behind it, nor one without silhouette.

    Parameters
    ----------
    test : not used.
    tolerance : silhouettes that may be wrong about a voxel; k out of n exclude it only if k > tolerance.

    Returns
    -------
    CarvedVolume
        Consistent: the voxels that some pixel sees, with the mean colour of its pixels; hidden: the others inside.

    Raises
    ------
    SceneError : no view has a silhouette.
    EmptyReconstructionError : nothing is inside; names the view that excludes most.

    References
    ----------
    Laurentini, "The visual hull concept for silhouette-based image understanding", PAMI 1994.
    """
    field = hull_distance(scene, volume, tolerance=tolerance)
    views = scene.packed
    occupied = volume.occupied & (field > 0)
    hull = CarvedVolume.untouched(volume, field)
    hull.labels[volume.occupied] = np.where(occupied[volume.occupied], Label.HIDDEN, Label.BACKGROUND)
    color_visible(hull, ItemBuffer(views, volume), occupied)
    if progress:
        progress(1, 1)
    return hull
