"""Exact visibility for arbitrary cameras: which voxel each pixel sees first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.views import ViewArrays
from recon3d.consistency import Patches
from recon3d.kernels.item_buffer import advance, collect_items, count_items, enter_volume
from recon3d.volume import CarvingVolume


class ItemBuffer:
    """The first occupied voxel on the ray of every pixel that may show the object.

    Rays run through pixel centres. Each walks the volume once in the whole run.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999 (GVC).
    Amanatides, Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
    """

    def __init__(self, views: ViewArrays, volume: CarvingVolume) -> None:
        self.views = views
        self.origin, self.size, self.shape = volume.origin, volume.voxel_size, np.array(volume.shape)
        self.items = np.empty(views.free.shape, np.int32)
        """(n_views, height, width) flat index of the voxel that the pixel sees, -1 where none."""
        enter_volume(
            self.shape, self.origin, self.size, views.centers, views.world_from_pixel, views.foreground, self.items
        )

    def advance(self, occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Move all rays on to their first voxel occupied now; flat indices, ascending, of voxels newly hit."""
        touched = np.zeros(occupied.size, np.bool_)
        advance(occupied, self.origin, self.size, self.views.centers, self.views.world_from_pixel, self.items, touched)
        return np.flatnonzero(touched)

    def patches(self, voxels: NDArray[np.int64]) -> Patches:
        """Visible pixels of voxels given by their flat indices; every one of them must be seen by some pixel."""
        rank = np.full(int(self.shape.prod()), -1, np.int32)
        rank[voxels] = np.arange(len(voxels), dtype=np.int32)
        counts = np.zeros((len(voxels), len(self.items)), np.int64)
        count_items(self.items, rank, counts)
        ends = np.cumsum(counts).reshape(counts.shape)
        view_starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
        colors = np.empty((int(ends[-1, -1]) if ends.size else 0, 3), np.uint8)
        collect_items(self.items, rank, view_starts, self.views.images, colors)
        return Patches(colors, view_starts)

    def visible(self) -> NDArray[np.int64]:
        """Flat indices, ascending, of the voxels that some pixel sees."""
        seen = np.zeros(int(self.shape.prod()), np.bool_)
        seen[self.items[self.items >= 0]] = True
        return np.flatnonzero(seen)
