"""The lattice that voxels lie on, and the memory that they take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
import psutil
from numpy.typing import ArrayLike, NDArray

from recon3d.checks import require_number, require_whole
from recon3d.errors import ArgumentError, VolumeTooLargeError
from recon3d.kernels import types
from recon3d.scene.bounds import Bounds
from recon3d.values import ByContent

BYTES_PER_VOXEL = 80
"""Peak memory of carving and meshing, measured on full volumes, rounded up."""


BAND = 3.0
"""Voxels beside the surface within which distance fields are kept."""


_LONGEST = 2**31  # voxels along a side, whose indices fit into 32 bits


@dataclass(frozen=True, eq=False)
class Lattice(ByContent):
    """Where voxels lie: voxel (i, j, k) spans ``origin + voxel_size * (i, j, k)`` to the same of (i+1, j+1, k+1)."""

    origin: NDArray[np.float64]
    """(3,) lowest corner of voxel (0, 0, 0), world units."""
    voxel_size: float
    """Edge length, world units."""
    shape: tuple[int, int, int]
    """(nx, ny, nz)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", np.asarray(self.origin, np.float64))
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        if self.origin.shape != (3,) or not np.isfinite(self.origin).all():
            raise ArgumentError(f"expected an origin of three finite numbers, got {self.origin}")
        require_number("voxel_size", self.voxel_size, "(0, inf)")
        if len(self.shape) != 3 or min(self.shape) < 1:
            raise ArgumentError(f"expected a shape of three positive numbers, got {self.shape}")

    @classmethod
    def enclosing(
        cls,
        bounds: Bounds | o3d.geometry.AxisAlignedBoundingBox,
        *,
        voxel_size: float | None = None,
        n_voxels: int | None = None,
    ) -> Lattice:
        """Lattice centred on a box, from a voxel size in world units or an approximate number of voxels.

        Raises
        ------
        VolumeTooLargeError : a side has 2^31 voxels or more.
        """
        bounds = Bounds.of(bounds)
        if (voxel_size is None) == (n_voxels is None):
            raise ArgumentError(f"expected either voxel_size or n_voxels, got {voxel_size} and {n_voxels}")
        if voxel_size is None:
            require_whole("n_voxels", n_voxels)
            voxel_size = float((bounds.extent.prod() / n_voxels) ** (1 / 3))
        require_number("voxel_size", voxel_size, "(0, inf)")
        shape = np.maximum(np.ceil(bounds.extent / voxel_size - 1e-6), 1)
        if not (shape < _LONGEST).all():
            raise VolumeTooLargeError(
                f"voxels of {voxel_size:.4g} would be {shape.max():.3g} along the longest side of bounds of "
                f"{' x '.join(f'{length:.4g}' for length in bounds.extent)}; expected a larger voxel size"
            )
        nx, ny, nz = (int(n) for n in shape)
        return cls(bounds.center - shape * voxel_size / 2, voxel_size, (nx, ny, nz))

    @property
    def n_voxels(self) -> int:
        """Of the whole lattice."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def packed(self) -> types.Lattice:
        """As kernels read it."""
        x, y, z = (float(value) for value in self.origin)
        return types.Lattice((x, y, z), float(self.voxel_size), self.shape)

    @property
    def bounds(self) -> Bounds:
        """Box of the whole lattice, world units."""
        return Bounds(self.origin, self.origin + self.voxel_size * np.array(self.shape))

    def centers(self, voxels: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, 3) world centres of voxels (n, 3)."""
        return self.origin + self.voxel_size * (voxels + 0.5)

    def check_memory(self, bytes_per_voxel: float = BYTES_PER_VOXEL) -> None:
        """Refuse to store every voxel where that needs more memory than is free; see ``check_memory``."""
        check_memory(self.n_voxels * bytes_per_voxel, self.shape, self.voxel_size)


def check_memory(needed: float, shape: ArrayLike, voxel_size: float, *, dimension: int = 3) -> None:
    """Refuse a volume (nx, ny, nz) that needs more memory, in bytes, than is free.

    Parameters
    ----------
    dimension : what the memory grows with: 3, the volume; 2, its surface.

    Raises
    ------
    VolumeTooLargeError : says how much is needed and free, and the voxel size that would fit.
    """
    available = psutil.virtual_memory().available
    if needed > available:
        fitting = voxel_size * (needed / (0.9 * available)) ** (1 / dimension)
        raise VolumeTooLargeError(
            f"{' x '.join(f'{n:.0f}' for n in np.asarray(shape))} voxels of {voxel_size:.4g} would need "
            f"{needed / 2**30:.1f} GiB and {available / 2**30:.1f} GiB are free; "
            f"a voxel size of {fitting:.4g} would fit"
        )
