"""The carving volume: an Open3D voxel grid's lattice with dense occupancy and colour."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.scene.bounds import Bounds
from recon3d.summary import Summarised, thumbnails
from recon3d.values import ByContent
from recon3d.volume.lattice import BYTES_PER_VOXEL, Lattice, check_memory


@dataclass(frozen=True, repr=False, eq=False)
class CarvingVolume(ByContent, Summarised):
    """Cubic voxels; voxel (i, j, k) spans ``origin + size * (i, j, k)`` to ``origin + size * (i+1, j+1, k+1)``."""

    origin: NDArray[np.float64]
    """(3,) lowest corner of voxel (0, 0, 0), world units."""
    voxel_size: float
    """Edge length, world units."""
    occupied: NDArray[np.bool_]
    """(nx, ny, nz)."""
    colors: NDArray[np.uint8]
    """(nx, ny, nz, 3) RGB; black where nothing is known."""

    def __post_init__(self) -> None:
        if self.occupied.ndim != 3 or self.occupied.dtype != np.bool_:
            raise ArgumentError(
                f"expected a bool occupancy (nx, ny, nz), got {self.occupied.shape} {self.occupied.dtype}"
            )
        if self.colors.shape != (*self.occupied.shape, 3) or self.colors.dtype != np.uint8:
            raise ArgumentError(
                f"expected uint8 colours {(*self.occupied.shape, 3)}, got {self.colors.shape} {self.colors.dtype}"
            )
        object.__setattr__(self, "origin", self.lattice.origin)

    @classmethod
    def enclosing(
        cls,
        bounds: Bounds | o3d.geometry.AxisAlignedBoundingBox,
        *,
        voxel_size: float | None = None,
        n_voxels: int | None = None,
    ) -> CarvingVolume:
        """Full volume centred on the bounds, from a voxel size in world units or an approximate number of voxels.

        Raises
        ------
        VolumeTooLargeError : it would not fit into the memory that is free now.
        """
        return cls.full(Lattice.enclosing(bounds, voxel_size=voxel_size, n_voxels=n_voxels))

    @classmethod
    def full(cls, volume: CarvingVolume | Lattice) -> CarvingVolume:
        """Full volume on a lattice; a volume is returned as it is.

        Raises
        ------
        VolumeTooLargeError : it would not fit into the memory that is free now.
        """
        if isinstance(volume, CarvingVolume):
            return volume
        volume.check_memory()
        shape = volume.shape
        return cls(volume.origin, volume.voxel_size, np.ones(shape, np.bool_), np.zeros((*shape, 3), np.uint8))

    @classmethod
    def from_voxel_grid(cls, grid: o3d.geometry.VoxelGrid, *, shape: ArrayLike | None = None) -> CarvingVolume:
        """Volume with the occupied voxels, colours and lattice of an Open3D voxel grid.

        Parameters
        ----------
        shape : (nx, ny, nz) of the volume; an Open3D grid knows only its occupied voxels. Just large enough for
            them when None. Voxels of negative index, which Open3D allows, move the origin.
        """
        if not np.allclose(grid.rotation, np.eye(3)):
            raise ArgumentError("expected an axis-aligned voxel grid, got a rotated one")
        voxels = grid.get_voxels()
        if not voxels:
            raise EmptyReconstructionError("the voxel grid holds no voxels")
        indices = np.array([voxel.grid_index for voxel in voxels], np.int64)
        shift = np.minimum(indices.min(axis=0), 0)
        indices -= shift
        needed = indices.max(axis=0) + 1
        size = needed if shape is None else np.asarray(shape, np.int64)
        if (size < needed).any():
            raise ArgumentError(f"expected a shape of at least {tuple(needed)}, got {tuple(size)}")
        check_memory(float(np.prod(size, dtype=np.float64)) * BYTES_PER_VOXEL, size, grid.voxel_size)
        occupied = np.zeros(tuple(size), np.bool_)
        colors = np.zeros((*size, 3), np.uint8)
        at = tuple(indices.T)
        occupied[at] = True
        if grid.has_colors():
            colors[at] = np.rint(255 * np.clip([voxel.color for voxel in voxels], 0, 1))
        return cls(np.asarray(grid.origin) + shift * grid.voxel_size, float(grid.voxel_size), occupied, colors)

    def to_voxel_grid(self) -> o3d.geometry.VoxelGrid:
        """Open3D voxel grid of the occupied voxels, with the same origin, indices and colours."""
        points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self.centers()))
        points.colors = o3d.utility.Vector3dVector(self.colors[self.occupied] / 255.0)
        box = self.bounds.to_open3d()
        # Only this constructor keeps the origin; it wants an upper bound beyond the last voxel.
        return o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(
            points, self.voxel_size, box.min_bound, box.max_bound
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nx, ny, nz)."""
        nx, ny, nz = self.occupied.shape
        return nx, ny, nz

    @property
    def lattice(self) -> Lattice:
        """Where the voxels lie."""
        return Lattice(self.origin, self.voxel_size, self.shape)

    @property
    def bounds(self) -> Bounds:
        """Box of the whole lattice, world units."""
        return self.lattice.bounds

    @property
    def n_occupied(self) -> int:
        """Number of occupied voxels."""
        return int(np.count_nonzero(self.occupied))

    def centers(self, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """(n, 3) world centres of the occupied voxels, or of those in a mask, in index order."""
        return self.origin + (np.argwhere(self.occupied if mask is None else mask) + 0.5) * self.voxel_size

    def surface(self) -> NDArray[np.bool_]:
        """(nx, ny, nz) occupied voxels with an empty face neighbour; beyond the volume is empty."""
        padded = np.pad(self.occupied, 1)
        inner = self.occupied.copy()
        for axis in range(3):
            for step in (-1, 1):
                inner &= np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
        return self.occupied & ~inner

    def with_occupancy(self, occupied: NDArray[np.bool_]) -> CarvingVolume:
        """The same lattice and colours with other voxels (nx, ny, nz) occupied."""
        return replace(self, occupied=occupied)

    def summary(self) -> dict[str, object]:
        """Table of what the volume holds."""
        return {
            "voxels": f"{' x '.join(map(str, self.shape))} = {self.occupied.size:,}",
            "voxel size": f"{self.voxel_size:.6g} world units",
            "occupied": f"{self.n_occupied:,} ({100 * self.n_occupied / self.occupied.size:.1f}%)",
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of the occupied voxels seen along the three axes."""
        return thumbnails([self._seen_along(axis) for axis in range(3)], width=200, columns=3)

    def _seen_along(self, axis: int) -> NDArray[np.uint8]:
        """RGB picture of the first occupied voxels along an axis; uncoloured ones grey by depth."""
        first = self.occupied.argmax(axis=axis)
        any_occupied = np.asarray(self.occupied.any(axis=axis))
        colors = np.take_along_axis(self.colors, np.expand_dims(first, (axis, 3)), axis=axis).squeeze(axis)
        depth = (230 - 150 * first / self.occupied.shape[axis]).astype(np.uint8)
        colors = np.where(colors.any(axis=2, keepdims=True), colors, depth[..., None])
        return np.where(any_occupied[..., None], colors, np.uint8(255))[:, ::-1].transpose(1, 0, 2).copy()
