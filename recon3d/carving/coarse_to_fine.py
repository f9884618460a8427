"""Carving from coarse to fine: bricks first, then the voxels of those that the surface crosses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.bricks import BrickItems, Bricks
from recon3d.carving.photo_hull import Progress
from recon3d.carving.views import ViewArrays
from recon3d.carving.visual_hull import nothing_inside, silhouette_outlines
from recon3d.kernels.bricks import BRICK, UNDECIDED
from recon3d.kernels.silhouettes import bound_bricks, sample_bricks
from recon3d.scene import Scene
from recon3d.sparse import SparseVolume
from recon3d.volume import BAND, enclosing_lattice


def fine_visual_hull(
    scene: Scene, voxel_size: float, *, tolerance: int = 0, progress: Progress | None = None
) -> SparseVolume:
    """Intersect the silhouettes' cones on a fine lattice, in memory and time that grow with the surface.

    The same voxels, distances and colours as ``visual_hull`` on the lattice that encloses the scene's bounds. A brick
    whose projections keep clear of every outline is empty or solid at once; the others are sampled at every voxel, and
    those that come within 3 voxels of the surface are stored.

    Parameters
    ----------
    voxel_size : edge length, world units.
    tolerance : silhouettes that may be wrong about a voxel; k out of n exclude it only if k > tolerance.
    progress : called with the number of steps done and of all: the hull, its colours.

    Raises
    ------
    SceneError : no view has a silhouette.
    VolumeTooLargeError : the bricks near the surface would not fit into the memory that is free now.
    EmptyReconstructionError : nothing is inside; names the view that excludes most.

    References
    ----------
    Laurentini, "The visual hull concept for silhouette-based image understanding", PAMI 1994.
    Szeliski, "Rapid octree construction from image sequences", CVGIP 1993 (coarse to fine).
    """
    report = progress or _silent
    bricks = hull_bricks(scene, voxel_size, tolerance=tolerance)
    report(1, 2)
    hull = bricks.colored(BrickItems(ViewArrays(scene), bricks))
    report(2, 2)
    return hull


def hull_bricks(scene: Scene, voxel_size: float, *, tolerance: int = 0) -> Bricks:
    """Visual hull in bricks, with the distance to it."""
    origin, shape = enclosing_lattice(scene.bounds, voxel_size)
    outlines = silhouette_outlines(scene, tolerance)
    hull = Bricks(origin, voxel_size, shape)
    lattice = (hull.shape, origin, voxel_size)
    limit = BAND * voxel_size

    slots = hull.slots
    bound_bricks(*lattice, *outlines, tolerance, limit, slots)
    undecided = np.argwhere(slots == UNDECIDED)
    kinds = np.empty(len(undecided), np.int32)
    sample_bricks(undecided, *lattice, *outlines, tolerance, limit, _no_field(0), kinds)
    slots[tuple(undecided.T)] = kinds

    stored = np.argwhere(slots == UNDECIDED)
    hull.require_memory(len(stored))
    field = _no_field(len(stored))
    sample_bricks(stored, *lattice, *outlines, tolerance, limit, field, np.empty(len(stored), np.int32))
    slots[tuple(stored.T)] = np.arange(len(stored), dtype=np.int32)
    hull.place(slots, field)
    if not hull.n_occupied:
        raise nothing_inside(scene, lambda alone: hull_bricks(alone, voxel_size).n_occupied / float(shape.prod()))
    return hull


def _no_field(n_bricks: int) -> NDArray[np.float32]:
    return np.empty((n_bricks, BRICK, BRICK, BRICK), np.float32)


def _silent(done: int, total: int) -> None:
    pass
