"""A sparse volume while it is carved, and which of its voxels the pixels see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.carving.item_buffer import SeenItems
from recon3d.carving.observations import mean_color
from recon3d.errors import ArgumentError
from recon3d.kernels.brick_rays import GONE, NOT_ENTERED, advance_bricks
from recon3d.kernels.bricks import BRICK, SOLID, StoredBricks, exposed_bricks
from recon3d.scene.packed import PackedViews
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import BAND, Lattice, check_memory
from recon3d.volume.sparse import SparseVolume, brick_grid, count_occupied, stored_bricks

BYTES_PER_BRICK = 96 * BRICK**3
"""Peak memory of carving and meshing for each stored brick, measured, rounded up."""
_BYTES_PER_CELL = 16  # of the brick grid: its slots and the masks over it
_MOST_STORED = np.iinfo(np.int32).max // BRICK**3  # rays keep flat places as 32-bit numbers


def whole_lattice(volume: CarvingVolume | Lattice) -> Lattice:
    """The lattice itself, or that of a full volume: carving from coarse to fine starts from nothing less.

    Raises
    ------
    ArgumentError : some voxels of the volume are empty.
    """
    if isinstance(volume, Lattice):
        return volume
    if not volume.occupied.all():
        empty = volume.occupied.size - volume.n_occupied
        raise ArgumentError(f"expected a lattice or a full volume, got one with {empty:,} empty voxels")
    return volume.lattice


class Bricks:
    """Occupancy that grows where it is carved: solid bricks are stored when something in them becomes visible."""

    def __init__(self, lattice: Lattice) -> None:
        self.lattice = lattice
        self.origin, self.size = lattice.origin, lattice.voxel_size
        self.shape = np.array(lattice.shape)
        """(3,) voxels of the lattice."""
        grid = brick_grid(self.shape)
        check_memory(_BYTES_PER_CELL * float(np.prod(grid, dtype=np.float64)), self.shape, self.size)
        self.slots = np.full(grid, SOLID, np.int32)
        self.bricks = np.empty((0, 3), np.int64)
        self.occupied = np.empty((0, BRICK, BRICK, BRICK), np.bool_)
        self.distance: NDArray[np.float32] | None = None
        """Of the bricks that it is known for, the first stored; in all others it is at its limit."""

    @property
    def stored(self) -> StoredBricks:
        """As kernels read them."""
        return StoredBricks(self.slots, self.bricks, self.occupied)

    @property
    def n_places(self) -> int:
        """Stored voxels."""
        return self.occupied.size

    @property
    def n_occupied(self) -> int:
        """Number of occupied voxels, stored or not."""
        return count_occupied(self.slots, self.occupied)

    def require_memory(self, n_bricks: int) -> None:
        """Refuse so many stored bricks if they would not fit into the memory that is free now."""
        needed = n_bricks * BYTES_PER_BRICK if n_bricks <= _MOST_STORED else np.inf
        check_memory(needed, self.shape, self.size, dimension=2)

    def store_ends(self) -> None:
        """Store the solid bricks that reach over the lattice's end, which are not solid throughout."""
        beyond = np.zeros(self.slots.shape, np.bool_)
        for axis in range(3):
            if self.shape[axis] % BRICK:
                np.moveaxis(beyond, axis, 0)[-1] = True
        self.store(beyond & (self.slots == SOLID))

    def place(self, slots: NDArray[np.int32], distance: NDArray[np.float32]) -> None:
        """Take over a brick grid and the distance (n, 8, 8, 8) of its stored bricks; occupied is what is inside."""
        self.slots, self.bricks = slots, stored_bricks(slots)
        self.distance, self.occupied = distance, distance > 0

    def store(self, mask: NDArray[np.bool_]) -> None:
        """Store the solid bricks of a mask (bx, by, bz)."""
        added = np.argwhere(mask)
        if not len(added):
            return
        self.require_memory(len(added))
        voxels = np.ones((len(added), BRICK, BRICK, BRICK), np.bool_)
        ends = self.shape - BRICK * added
        for axis in range(3):
            over = np.arange(BRICK)[None] >= ends[:, axis, None]
            np.moveaxis(voxels, axis + 1, 1)[over] = False
        self.slots[tuple(added.T)] = np.arange(len(self.bricks), len(self.bricks) + len(added), dtype=np.int32)
        self.bricks = np.concatenate([self.bricks, added])
        self.occupied = np.concatenate([self.occupied, voxels])

    def store_surface(self) -> None:
        """Store the solid bricks that an empty voxel borders on."""
        exposed = np.zeros(self.slots.shape, np.bool_)
        exposed_bricks(self.slots, self.occupied, exposed)
        self.store(exposed)

    def colored(self, buffer: BrickItems) -> SparseVolume:
        """The volume with the mean colour of its pixels at every voxel that some pixel sees.

        Surface voxels that none does take the colour of the nearest one that is seen.
        """
        buffer.advance()
        self.store_surface()
        buffer.fit()
        visible = buffer.visible()
        patches = buffer.patches(visible)
        colors = np.zeros((*self.occupied.shape, 3), np.uint8)
        colors.reshape(-1, 3)[visible] = mean_color(patches)
        volume = SparseVolume(
            self.origin, self.size, (int(self.shape[0]), int(self.shape[1]), int(self.shape[2])), self.slots,
            self.occupied, buffer.visible_mask().reshape(self.occupied.shape), colors, self._full_distance(),
        )  # fmt: skip
        unseen = volume.surface() & ~volume.visible
        if len(visible) and unseen.any():
            _, nearest = cKDTree(volume.voxels(volume.visible)).query(volume.voxels(unseen), workers=-1)
            colors[unseen] = colors[volume.visible][nearest]
        return replace(volume, colors=colors)

    def _full_distance(self) -> NDArray[np.float32] | None:
        if self.distance is None:
            return None
        distance = np.empty(self.occupied.shape, np.float32)
        known = len(self.distance)
        distance[:known] = self.distance
        limit = np.float32(BAND * self.size)
        distance[known:] = limit
        return distance


class BrickItems(SeenItems):
    """The item buffer of bricks: rays pass by empty ones and have solid ones stored where they meet them.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999 (GVC).
    Amanatides, Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
    """

    def __init__(self, views: PackedViews, bricks: Bricks) -> None:
        super().__init__(views, bricks.n_places)
        self.bricks = bricks
        self.items[:] = np.where(views.foreground, np.int32(NOT_ENTERED), np.int32(GONE))

    def fit(self) -> None:
        """Update the voxel count after bricks were stored."""
        self.n_places = self.bricks.n_places

    def advance(self) -> NDArray[np.int64]:
        """Move all rays on to their first voxel occupied now; places (n,), ascending, of voxels newly hit."""
        volume, views = self.bricks, self.views
        touched = np.zeros(0, np.bool_)
        while True:
            touched = np.concatenate([touched, np.zeros(volume.n_places - len(touched), np.bool_)])
            missing = np.zeros(volume.slots.shape, np.bool_)
            advance_bricks(volume.lattice.packed, volume.stored, views.cameras, self.items, touched, missing)
            if not missing.any():
                break
            volume.store(missing)
        self.fit()
        return np.flatnonzero(touched)
