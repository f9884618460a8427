"""Rays through the voxel lattice from camera centres, and what voxels look like in the views."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.footprints import footprint
from recon3d.kernels.lattice import corner_of
from recon3d.kernels.types import Cameras, Lattice, Observed


@kernel(parallel=True)
def observe(
    part: Part,
    lattice: Lattice,
    cameras: Cameras,
    foreground: NDArray[np.bool_],
    images: NDArray[np.uint8],
    observed: Observed,
) -> None:
    """Mean foreground colour of every voxel's footprint, and which views have one."""
    voxels, colors, seen = observed
    for n in span(part, voxels.shape[0]):
        corner = corner_of(lattice, voxels[n, 0], voxels[n, 1], voxels[n, 2])
        for view in range(images.shape[0]):
            u0, u1, v0, v1, _ = footprint(cameras, view, corner, lattice.voxel_size)
            count = red = green = blue = 0
            for v in range(v0, v1 + 1):
                for u in range(u0, u1 + 1):
                    if foreground[view, v, u]:
                        count += 1
                        red += images[view, v, u, 0]
                        green += images[view, v, u, 1]
                        blue += images[view, v, u, 2]
            seen[n, view] = count > 0
            if count > 0:
                colors[n, view, 0] = (2 * red + count) // (2 * count)
                colors[n, view, 1] = (2 * green + count) // (2 * count)
                colors[n, view, 2] = (2 * blue + count) // (2 * count)


@kernel()
def walk(
    center: NDArray[np.float64], voxel: NDArray[np.int64], shape: Any, beyond: bool, path: NDArray[np.int64]
) -> int:
    """Fill path with the flat indices of the voxels on the ray from a centre through the middle of a voxel (3,).

    In order, to that voxel or beyond it to the lattice's end; returns how many. The centre is in voxels from the
    lattice's origin; the walk begins at one inside the lattice. A path holds at most nx + ny + nz voxels.

    Amanatides, Woo, "A fast voxel traversal algorithm for ray tracing", 1987.
    """
    # An array, not a generator: those fail in a caller that is compiled after they were loaded from the cache.
    nx, ny, nz = shape
    i, j, k = voxel[0], voxel[1], voxel[2]
    dx, dy, dz = i + 0.5 - center[0], j + 0.5 - center[1], k + 0.5 - center[2]
    begin, end = 0.0, np.inf
    for length, start, step in ((nx, center[0], dx), (ny, center[1], dy), (nz, center[2], dz)):
        if step != 0.0:
            one, other = -start / step, (length - start) / step
            begin, end = max(begin, min(one, other)), min(end, max(one, other))
    if begin >= end:
        return 0
    # The place of entry may round to just outside.
    a = min(max(int(np.floor(center[0] + begin * dx)), 0), nx - 1)
    b = min(max(int(np.floor(center[1] + begin * dy)), 0), ny - 1)
    c = min(max(int(np.floor(center[2] + begin * dz)), 0), nz - 1)
    step_a, step_b, step_c = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1, 1 if dz > 0.0 else -1
    next_a = (a + (dx > 0.0) - center[0]) / dx if dx != 0.0 else np.inf
    next_b = (b + (dy > 0.0) - center[1]) / dy if dy != 0.0 else np.inf
    next_c = (c + (dz > 0.0) - center[2]) / dz if dz != 0.0 else np.inf
    each_a, each_b, each_c = abs(1.0 / dx), abs(1.0 / dy), abs(1.0 / dz)
    count = 0
    while 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
        path[count] = (a * ny + b) * nz + c
        count += 1
        if not beyond and a == i and b == j and c == k:
            break
        if next_a <= next_b and next_a <= next_c:
            a += step_a
            next_a += each_a
        elif next_b <= next_c:
            b += step_b
            next_b += each_b
        else:
            c += step_c
            next_c += each_c
    return count
