"""Exact visibility for arbitrary cameras: which voxel each pixel sees first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.observations import room_for
from recon3d.consistency.base import Patches
from recon3d.errors import VolumeTooLargeError
from recon3d.kernels.item_buffer import advance, collect_items, count_items, enter_volume
from recon3d.scene.packed import PackedViews
from recon3d.volume.dense import CarvingVolume


class SeenItems:
    """What every pixel sees, whatever the voxels are kept in."""

    def __init__(self, views: PackedViews, n_places: int) -> None:
        most = np.iinfo(np.int32).max
        if n_places > most:
            raise VolumeTooLargeError(f"{n_places:,} voxels are more than an item buffer can number ({most:,})")
        self.views = views
        self.n_places = n_places
        """Voxels that a pixel may see."""
        self.items = np.empty(views.foreground.shape, np.int32)
        """(n_views, height, width) flat index of the voxel that the pixel sees, negative where none."""
        self._rank = np.empty(0, np.int32)

    def patches(self, voxels: NDArray[np.int64]) -> Patches:
        """Visible pixels of voxels given by their flat indices (n,); every one of them must be seen by some pixel."""
        if len(self._rank) != self.n_places:
            self._rank = np.full(self.n_places, -1, np.int32)
        self._rank[voxels] = np.arange(len(voxels), dtype=np.int32)
        counts = np.zeros((len(voxels), len(self.items)), np.int64)
        count_items(self.items, self._rank, counts)
        pixels = room_for(counts)
        collect_items(self.items, self._rank, self.views.images, pixels)
        self._rank[voxels] = -1
        return Patches(*pixels)

    def visible_mask(self) -> NDArray[np.bool_]:
        """(n_places,) voxels that some pixel sees."""
        seen = np.zeros(self.n_places, np.bool_)
        seen[self.items[self.items >= 0]] = True
        return seen

    def visible(self) -> NDArray[np.int64]:
        """(n,) flat indices, ascending, of the voxels that some pixel sees."""
        return np.flatnonzero(self.visible_mask())


class ItemBuffer(SeenItems):
    """The first occupied voxel on the ray of every pixel that may show the object.

    Rays run through pixel centres. Each walks the volume once in the whole run.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999 (GVC).
    Amanatides, Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
    """

    def __init__(self, views: PackedViews, volume: CarvingVolume) -> None:
        super().__init__(views, volume.occupied.size)
        self.lattice = volume.lattice.packed
        enter_volume(self.lattice, views.cameras, views.foreground, self.items)
        self._entered = False

    def advance(self, occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Move all rays on to their first voxel of those occupied now, (nx, ny, nz).

        Returns the flat indices (n,), ascending, of the voxels newly hit.
        """
        touched = np.zeros(occupied.size, np.bool_)
        advance(occupied, self.lattice, self.views.cameras, self.items, touched)
        if not self._entered:  # rays that enter the volume at an occupied voxel hit it without a step
            self._entered = True
            return self.visible()
        return np.flatnonzero(touched)
