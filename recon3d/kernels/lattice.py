"""Places and neighbourhoods on the voxel lattice."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel
from recon3d.kernels.types import Lattice


@kernel()
def corner_of(lattice: Lattice, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Lowest corner of a voxel, world."""
    x, y, z = lattice.origin
    size = lattice.voxel_size
    return x + i * size, y + j * size, z + k * size


@kernel()
def center_of(lattice: Lattice, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Centre of a voxel, world."""
    x, y, z = lattice.origin
    size = lattice.voxel_size
    return x + (i + 0.5) * size, y + (j + 0.5) * size, z + (k + 0.5) * size


@kernel()
def grow_consistent(
    labels: NDArray[np.uint8],
    candidates: NDArray[np.int64],
    offsets: NDArray[np.int64],
    candidate: int,
    consistent: int,
) -> None:
    """Turn into consistent every candidate (n, 3) that candidates connect to a consistent voxel."""
    stack = np.empty((candidates.shape[0], 3), np.int64)
    depth = 0
    for n in range(candidates.shape[0]):
        i, j, k = candidates[n, 0], candidates[n, 1], candidates[n, 2]
        if labels[i, j, k] == candidate and _touches(labels, i, j, k, offsets, consistent):
            labels[i, j, k] = consistent
            stack[0, 0], stack[0, 1], stack[0, 2] = i, j, k
            depth = 1
        while depth > 0:
            depth -= 1
            i, j, k = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            for o in range(offsets.shape[0]):
                a, b, c = i + offsets[o, 0], j + offsets[o, 1], k + offsets[o, 2]
                if _inside(labels, a, b, c) and labels[a, b, c] == candidate:
                    labels[a, b, c] = consistent
                    stack[depth, 0], stack[depth, 1], stack[depth, 2] = a, b, c
                    depth += 1


@kernel()
def _inside(labels: NDArray[np.uint8], i: int, j: int, k: int) -> bool:
    """Whether the index lies in the volume."""
    return 0 <= i < labels.shape[0] and 0 <= j < labels.shape[1] and 0 <= k < labels.shape[2]


@kernel()
def _touches(labels: NDArray[np.uint8], i: int, j: int, k: int, offsets: NDArray[np.int64], label: int) -> bool:
    """Whether a neighbour of the voxel has the label."""
    for o in range(offsets.shape[0]):
        a, b, c = i + offsets[o, 0], j + offsets[o, 1], k + offsets[o, 2]
        if _inside(labels, a, b, c) and labels[a, b, c] == label:
            return True
    return False
