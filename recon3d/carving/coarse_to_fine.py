"""Carving from coarse to fine: bricks first, then the voxels of those that the surface crosses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.bricks import BrickItems, Bricks
from recon3d.carving.generalized import all_carved, carve_to_agreement
from recon3d.carving.hysteresis import Connectivity, neighbour_offsets
from recon3d.carving.start import nothing_inside, silhouette_outlines
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.kernels.bricks import BRICK, UNDECIDED, grow_support
from recon3d.kernels.silhouettes import bound_bricks, sample_bricks
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.lattice import BAND, enclosing_lattice
from recon3d.volume.sparse import SparseVolume


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
    hull = bricks.colored(BrickItems(scene.packed, bricks))
    report(2, 2)
    return hull


def hull_bricks(scene: Scene, voxel_size: float, *, tolerance: int = 0) -> Bricks:
    """Visual hull in bricks, with the distance to it."""
    origin, shape = enclosing_lattice(scene.bounds, voxel_size)
    outlines = silhouette_outlines(scene, tolerance)
    hull = Bricks(origin, shape, voxel_size)
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


def fine_generalized_voxel_coloring(
    scene: Scene,
    voxel_size: float,
    test: ConsistencyTest | None = None,
    *,
    connectivity: Connectivity = 26,
    max_rounds: int = 1000,
    progress: Progress | None = None,
) -> SparseVolume:
    """Generalised voxel colouring on a fine lattice, in memory and time that grow with the surface.

    The same voxels and colours as ``generalized_voxel_coloring`` on the lattice that encloses the scene's bounds, from
    the visual hull where there are silhouettes, else from the whole lattice. Rays pass by empty bricks in one step,
    and a solid brick is stored when the first ray meets it.

    Voxels much smaller than a pixel's footprint are seen by few pixels each, and by some test's reading one pixel
    always agrees with itself: the scene's ``pixel_footprint`` is the finest size at which carving says much.

    Parameters
    ----------
    voxel_size : edge length, world units.
    test : the photo-consistency test; the paper's fuzzy test when None.
    connectivity : neighbours that carry a candidate: 6 (faces), 18 (edges), 26 (corners).
    max_rounds : stop after so many rounds, with what is left then.
    progress : called with the number of rounds done and the most there may be.

    Raises
    ------
    VolumeTooLargeError : the bricks near the surface would not fit into the memory that is free now.
    EmptyReconstructionError : nothing is inside all silhouettes, or every visible voxel was carved.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999.
    """
    test = FuzzyAdaptiveHysteresis() if test is None else test
    if any(view.has_silhouette for view in scene.views):
        bricks = hull_bricks(scene, voxel_size)
    else:
        bricks = Bricks(*enclosing_lattice(scene.bounds, voxel_size), voxel_size)
        bricks.store_ends()
    started = bricks.n_occupied

    state = _SparseState(bricks, BrickItems(scene.packed, bricks), connectivity)
    carve_to_agreement(state, test, max_rounds=max_rounds, progress=progress)
    if not bricks.n_occupied:
        raise all_carved(scene, test, started, f"voxels of {voxel_size:.4g}")
    return bricks.colored(state.buffer)


class _SparseState:
    """Generalised voxel colouring of bricks."""

    def __init__(self, bricks: Bricks, buffer: BrickItems, connectivity: Connectivity) -> None:
        self.bricks, self.buffer = bricks, buffer
        self.patches = buffer.patches
        self.views, self.voxel_size = buffer.views, bricks.size
        self.consistent = np.zeros(0, np.bool_)
        self.offsets = neighbour_offsets(connectivity)

    def advance(self) -> NDArray[np.int64]:
        newly_hit = self.buffer.advance()
        stored = np.zeros(self.bricks.n_places - len(self.consistent), np.bool_)
        self.consistent = np.concatenate([self.consistent, stored])
        return newly_hit

    def centers(self, voxels: NDArray[np.int64]) -> NDArray[np.float64]:
        brick, *within = np.unravel_index(voxels, self.bricks.occupied.shape)
        indices = BRICK * self.bricks.bricks[brick] + np.stack(within, axis=1)
        return np.asarray(self.bricks.origin + self.voxel_size * (indices + 0.5))

    def note(self, voxels: NDArray[np.int64], patches: Patches, verdict: Verdict) -> None:  # noqa: ARG002
        self.consistent[voxels] = verdict.degree >= verdict.high

    def unsupported(self) -> NDArray[np.int64]:
        visible = self.buffer.visible_mask()
        supported = visible & self.consistent
        seeds, n_visible = np.flatnonzero(supported), int(np.count_nonzero(visible))
        grow_support(self.bricks.slots, self.bricks.bricks, visible, self.offsets, supported, seeds, n_visible)
        return np.flatnonzero(visible & ~supported)

    def carve(self, voxels: NDArray[np.int64]) -> None:
        self.bricks.occupied.reshape(-1)[voxels] = False


def _no_field(n_bricks: int) -> NDArray[np.float32]:
    return np.empty((n_bricks, BRICK, BRICK, BRICK), np.float32)


def _silent(done: int, total: int) -> None:
    pass
