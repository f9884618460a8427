"""The lattice that voxels lie on, and the memory that they take."""

from __future__ import annotations

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import VolumeTooLargeError
from recon3d.scene.bounds import Bounds

BYTES_PER_VOXEL = 80
"""Peak memory of carving and meshing, measured on full volumes, rounded up."""


BAND = 3.0
"""Voxels beside the surface within which distance fields are kept."""


def enclosing_lattice(bounds: Bounds, voxel_size: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origin (3,) and whole numbers of voxels (3,) of the lattice of a voxel size that is centred on a box."""
    if not (np.isfinite(voxel_size) and voxel_size > 0):
        raise ValueError(f"expected a positive voxel size, got {voxel_size}")
    shape = np.maximum(np.ceil(bounds.extent / voxel_size - 1e-6), 1)
    return bounds.center - shape * voxel_size / 2, shape


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
