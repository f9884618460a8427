"""Volumes that store only the voxels near a surface."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.bricks import BRICK, SOLID, StoredBricks, copy_box, exposed_bricks, surface_voxels
from recon3d.scene.bounds import Bounds
from recon3d.summary import Summarised, thumbnails
from recon3d.values import ByContent
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.lattice import BAND, Lattice


@dataclass(frozen=True, repr=False, eq=False)
class SparseVolume(ByContent, Summarised):
    """A carved volume of which only the bricks of 8 x 8 x 8 voxels near the surface are stored.

    Every other brick is empty or solid throughout. All occupied voxels with an empty face neighbour are stored, so
    that memory grows with the surface and not with the volume.
    """

    origin: NDArray[np.float64]
    """(3,) lowest corner of voxel (0, 0, 0), world units."""
    voxel_size: float
    """Edge length, world units."""
    shape: tuple[int, int, int]
    """(nx, ny, nz) voxels of the whole lattice."""
    slots: NDArray[np.int32]
    """(bx, by, bz) of every brick: where it is stored in the arrays below; -1: it is empty, -2: it is solid."""
    occupied: NDArray[np.bool_]
    """(n_stored, 8, 8, 8). Voxels beyond the lattice, in bricks that reach over its end, are empty."""
    visible: NDArray[np.bool_]
    """(n_stored, 8, 8, 8) occupied voxels that some pixel sees: those whose colours are measured."""
    colors: NDArray[np.uint8]
    """(n_stored, 8, 8, 8, 3) RGB; black where nothing is known."""
    distance: NDArray[np.float32] | None = None
    """(n_stored, 8, 8, 8) signed distance of voxel centres to the visual hull, world units, positive inside; if known.

    Cut off at 3 voxels, which is what it is in all bricks that are not stored."""

    def __post_init__(self) -> None:
        lattice = Lattice(self.origin, self.voxel_size, self.shape)
        object.__setattr__(self, "origin", lattice.origin)
        object.__setattr__(self, "shape", lattice.shape)
        grid = brick_grid(self.shape)
        if self.slots.shape != grid or self.slots.dtype != np.int32:
            raise ArgumentError(f"expected int32 slots {grid}, got {self.slots.shape} {self.slots.dtype}")
        stored = np.sort(self.slots[self.slots >= 0])
        n = len(self.occupied)
        if not np.array_equal(stored, np.arange(n)) or self.slots.min() < SOLID:
            raise ArgumentError(f"expected each of the {n} stored bricks once in slots, and else -1 or -2")
        voxels = (n, BRICK, BRICK, BRICK)
        for name, dtype, expected in (
            ("occupied", np.bool_, voxels),
            ("visible", np.bool_, voxels),
            ("colors", np.uint8, (*voxels, 3)),
            ("distance", np.float32, voxels),
        ):
            array = getattr(self, name)
            if array is not None and (array.shape != expected or array.dtype != dtype):
                raise ArgumentError(f"expected {name} {expected} {dtype.__name__}, got {array.shape} {array.dtype}")
        exposed = np.zeros(grid, np.bool_)
        exposed_bricks(self.slots, self.occupied, exposed)
        if exposed.any():
            raise ArgumentError(
                f"{np.count_nonzero(exposed)} solid bricks border on an empty voxel: they must be stored"
            )

    @property
    def lattice(self) -> Lattice:
        """Where the voxels lie."""
        return Lattice(self.origin, self.voxel_size, self.shape)

    @property
    def bounds(self) -> Bounds:
        """Box of the whole lattice, world units."""
        return self.lattice.bounds

    @property
    def n_accepted(self) -> int:
        """Number of voxels that some pixel sees."""
        return int(np.count_nonzero(self.visible))

    def counts(self) -> dict[str, int]:
        """Number of voxels with each label; what took the others away is not kept: all carved are "inconsistent"."""
        numbers = dict.fromkeys(Label, 0)
        numbers[Label.CONSISTENT] = self.n_accepted
        numbers[Label.HIDDEN] = self.n_occupied - self.n_accepted
        numbers[Label.INCONSISTENT] = self.lattice.n_voxels - self.n_occupied
        return {label.name.lower(): number for label, number in numbers.items()}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that is known beside the lattice, for a file."""
        known = {name: getattr(self, name) for name in ("slots", "occupied", "visible", "colors", "distance")}
        return {name: array for name, array in known.items() if array is not None}

    @classmethod
    def from_arrays(cls, lattice: Lattice, arrays: Mapping[str, NDArray[Any]]) -> SparseVolume:
        """The volume that ``arrays`` were of, on the same lattice."""
        return cls(lattice.origin, lattice.voxel_size, lattice.shape, **arrays)

    @property
    def bricks(self) -> NDArray[np.int64]:
        """(n_stored, 3) where each stored brick lies; its lowest voxel is 8 times that."""
        return stored_bricks(self.slots)

    @property
    def n_occupied(self) -> int:
        """Number of occupied voxels, stored or not."""
        return count_occupied(self.slots, self.occupied)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        arrays = (self.slots, self.occupied, self.visible, self.colors, self.distance)
        return sum(array.nbytes for array in arrays if array is not None)

    def surface(self) -> NDArray[np.bool_]:
        """(n_stored, 8, 8, 8) occupied voxels with an empty face neighbour; beyond the lattice is empty."""
        surface = np.zeros_like(self.occupied)
        surface_voxels(StoredBricks(self.slots, self.bricks, self.occupied), surface)
        return surface

    def voxels(self, mask: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
        """(n, 3) lattice indices of the surface's voxels, or of those in a mask (n_stored, 8, 8, 8), brick by brick."""
        slot, *local = np.nonzero(self.surface() if mask is None else mask)
        indices = BRICK * self.bricks[slot]
        for axis in range(3):
            indices[:, axis] += local[axis]
        return indices

    def centers(self, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """(n, 3) world centres of the surface's voxels, or of those in a mask (n_stored, 8, 8, 8), brick by brick."""
        return self.origin + (self.voxels(mask) + 0.5) * self.voxel_size

    def box(self, low: ArrayLike, shape: tuple[int, int, int]) -> tuple[NDArray[np.bool_], NDArray[np.float32] | None]:
        """Dense occupancy, and distance if known, of a box of voxels.

        Parameters
        ----------
        low : (3,) index of its lowest voxel; may be negative, and the box may reach beyond the lattice, which is empty.
        shape : its voxels along x, y and z.
        """
        start = np.asarray(low, np.int64)
        occupied = np.empty(shape, np.bool_)
        copy_box(self.slots, self.occupied, start, False, True, occupied)
        if self.distance is None:
            return occupied, None
        distance = np.empty(shape, np.float32)
        limit = np.float32(BAND * self.voxel_size)
        copy_box(self.slots, self.distance, start, -limit, limit, distance)
        return occupied, distance

    def dense(self) -> CarvedVolume:
        """The same voxels, all stored; without degrees and views, and labelled as in ``counts``.

        Raises
        ------
        VolumeTooLargeError : they would not fit into the memory that is free now.
        """
        self.lattice.check_memory()
        occupied, distance = self.box((0, 0, 0), self.shape)
        hull = CarvedVolume.untouched(self.lattice, distance)
        hull.labels[...] = np.where(occupied, Label.HIDDEN, Label.INCONSISTENT)
        visible = self.voxels(self.visible)
        hull.set_labels(visible, Label.CONSISTENT)
        hull.accept(visible, self.colors[self.visible])
        return hull

    def to_voxel_grid(self) -> o3d.geometry.VoxelGrid:
        """Open3D voxel grid of the surface's voxels, with the same origin, indices and colours."""
        surface = self.surface()
        if not surface.any():
            raise EmptyReconstructionError("the volume holds no voxels, so it has no surface")
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.centers(surface)))
        points.colors = o3d.utility.Vector3dVector(self.colors[surface] / 255.0)
        box = self.bounds.to_open3d()
        # Only this constructor keeps the origin; it wants an upper bound beyond the last voxel.
        return o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(
            points, self.voxel_size, box.min_bound, box.max_bound
        )

    def summary(self) -> dict[str, object]:
        """Table of what the volume holds."""
        total = int(np.prod(self.shape, dtype=np.int64))
        return {
            "voxels": f"{' x '.join(map(str, self.shape))} = {total:,}",
            "voxel size": f"{self.voxel_size:.6g} world units",
            "occupied": f"{self.n_occupied:,} ({100 * self.n_occupied / total:.1f}%)",
            "visible": f"{np.count_nonzero(self.visible):,}",
            "stored": f"{self.occupied.size:,} ({100 * self.occupied.size / total:.1f}%)",
            "memory": f"{self.nbytes / 2**20:.1f} MiB",
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of the surface's voxels seen along the three axes."""
        surface = self.surface()
        voxels, colors = self.voxels(surface), self.colors[surface]
        step = -(-max(self.shape) // 200)
        return thumbnails([self._seen_along(axis, voxels, colors, step) for axis in range(3)], width=200, columns=3)

    def _seen_along(
        self, axis: int, voxels: NDArray[np.int64], colors: NDArray[np.uint8], step: int
    ) -> NDArray[np.uint8]:
        """RGB picture of the first of voxels (n, 3) along an axis, at every step-th voxel; black ones grey by depth."""
        across = [other for other in range(3) if other != axis]
        order = np.argsort(-voxels[:, axis], kind="stable")  # the nearest is written last
        depth = (230 - 150 * voxels[:, axis] / self.shape[axis]).astype(np.uint8)
        shown = np.where(colors.any(axis=1, keepdims=True), colors, depth[:, None])[order]
        column, row = (voxels[order][:, across] // step).T
        width, height = (-(-self.shape[other] // step) for other in across)
        picture = np.full((height, width, 3), 255, np.uint8)
        picture[height - 1 - row, column] = shown
        return picture


def brick_grid(shape: ArrayLike) -> tuple[int, int, int]:
    """(bx, by, bz) bricks that cover a lattice of (nx, ny, nz) voxels."""
    bx, by, bz = (-(-int(n) // BRICK) for n in np.asarray(shape))
    return bx, by, bz


def stored_bricks(slots: NDArray[np.int32]) -> NDArray[np.int64]:
    """(n_stored, 3) places of the stored bricks in the brick grid, in the order that they are stored in."""
    bricks = np.argwhere(slots >= 0)
    places = np.empty_like(bricks)
    places[slots[tuple(bricks.T)]] = bricks
    return places


def count_occupied(slots: NDArray[np.int32], occupied: NDArray[np.bool_]) -> int:
    """Number of occupied voxels: stored ones (n, 8, 8, 8), and those of solid bricks in the slots (bx, by, bz)."""
    return int(np.count_nonzero(occupied)) + int(np.count_nonzero(slots == SOLID)) * BRICK**3
