"""Generalised voxel colouring of bricks, of which only those near the surface are stored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.bricks import BrickItems, Bricks, whole_lattice
from recon3d.carving.fine_visual_hull import hull_bricks
from recon3d.carving.generalized import GeneralizedVoxelColoring, all_carved, carve_to_agreement
from recon3d.carving.hysteresis import Connectivity, neighbour_offsets
from recon3d.carving.method import JudgingMethod
from recon3d.carving.observer import Observer
from recon3d.carving.start import any_silhouette
from recon3d.checks import require_whole
from recon3d.consistency.base import Patches, Verdict
from recon3d.errors import ArgumentError
from recon3d.kernels.bricks import BRICK, grow_support
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume


@dataclass(frozen=True)
class FineGeneralizedVoxelColoring(JudgingMethod):
    """Generalised voxel colouring on a fine lattice, in memory and time that grow with the surface.

    The same voxels and colours as those of ``GeneralizedVoxelColoring``, from the visual hull where there are
    silhouettes, else from the whole lattice. Rays pass by empty bricks in one step, and a solid brick is stored when
    the first ray meets it.

    Voxels much smaller than a pixel's footprint are seen by few pixels each, and by some test's reading one pixel
    always agrees with itself: the scene's ``pixel_footprint`` is the finest size at which carving says much.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999.
    """

    max_rounds: int = 1000
    """Stop after so many rounds, with what is left then."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole("max_rounds", self.max_rounds)

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,
    ) -> SparseVolume:
        """Carve a lattice round by round.

        Raises
        ------
        ArgumentError : a volume that is not full, or an observer, who needs the labels of all voxels.
        VolumeTooLargeError : the bricks near the surface would not fit into the memory that is free now.
        EmptyReconstructionError : nothing is inside all silhouettes, or every visible voxel was carved.
        """
        if observer:
            raise ArgumentError("an observer needs the labels of all voxels: give it to the method's dense()")
        lattice = whole_lattice(volume)
        if any_silhouette(scene):
            bricks = hull_bricks(scene, lattice)
        else:
            bricks = Bricks(lattice)
            bricks.store_ends()
        started = bricks.n_occupied

        state = _SparseState(bricks, BrickItems(scene.packed, bricks), self.connectivity)
        carve_to_agreement(state, self.test, max_rounds=self.max_rounds, progress=progress)
        if not bricks.n_occupied:
            raise all_carved(scene, self.test, started, f"voxels of {bricks.size:.4g}")
        return bricks.colored(state.buffer)

    def dense(self) -> GeneralizedVoxelColoring:
        """The method that leaves the same voxels with all of them stored."""
        return GeneralizedVoxelColoring(self.test, self.connectivity, self.max_rounds)


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
        self.consistent[voxels] = verdict.consistent

    def unsupported(self) -> NDArray[np.int64]:
        visible = self.buffer.visible_mask()
        supported = visible & self.consistent
        seeds, n_visible = np.flatnonzero(supported), int(np.count_nonzero(visible))
        grow_support(self.bricks.stored, visible, self.offsets, supported, seeds, n_visible)
        return np.flatnonzero(visible & ~supported)

    def carve(self, voxels: NDArray[np.int64]) -> None:
        self.bricks.occupied.reshape(-1)[voxels] = False
