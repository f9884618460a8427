"""Voxels to pixels: footprints in the views, the pixels still free in them, and marks."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.lattice import corner_of
from recon3d.kernels.types import Cameras, Footprints, Lattice, Pixels


@kernel()
def footprint(cameras: Cameras, view: int, lowest: tuple[float, float, float], size: float) -> Any:
    """Inclusive pixel box (u0, u1, v0, v1) of a voxel's eight corners, and whether it lies wholly in the image.

    Given are the lowest corner and the edge's length, world. u0 > u1 or v0 > v1: the view does not see the voxel.
    """
    projection, width, height = cameras.projections[view], cameras.sizes[view, 0], cameras.sizes[view, 1]
    x, y, z = lowest
    u_min = v_min = np.inf
    u_max = v_max = -np.inf
    for corner in range(8):
        cx = x + size * (corner & 1)
        cy = y + size * ((corner >> 1) & 1)
        cz = z + size * (corner >> 2)
        depth = projection[2, 0] * cx + projection[2, 1] * cy + projection[2, 2] * cz + projection[2, 3]
        if depth <= 0.0:
            return 0, -1, 0, -1, False
        inverse = 1.0 / depth
        u = (projection[0, 0] * cx + projection[0, 1] * cy + projection[0, 2] * cz + projection[0, 3]) * inverse
        v = (projection[1, 0] * cx + projection[1, 1] * cy + projection[1, 2] * cz + projection[1, 3]) * inverse
        u_min = min(u_min, u)
        u_max = max(u_max, u)
        v_min = min(v_min, v)
        v_max = max(v_max, v)
    u0, u1 = _pixel_range(u_min, u_max, width)
    v0, v1 = _pixel_range(v_min, v_max, height)
    whole = u0 >= 0 and u1 < width and v0 >= 0 and v1 < height
    return max(u0, 0), min(u1, width - 1), max(v0, 0), min(v1, height - 1), whole


@kernel()
def _pixel_range(low: float, high: float, length: int) -> Any:
    """Integers within [low, high], else the nearest one; clamped to one pixel outside the image."""
    low = min(max(low, -1.0), float(length))
    high = min(max(high, -1.0), float(length))
    first = int(np.ceil(low))
    last = int(np.floor(high))
    if first > last:
        first = last = int(np.floor(0.5 * (low + high) + 0.5))
    return first, last


@kernel()
def _box_sum(integral: NDArray[np.int32], u0: int, u1: int, v0: int, v1: int) -> Any:
    """Sum of an image over an inclusive pixel box, from its summed-area table."""
    return integral[v1 + 1, u1 + 1] - integral[v0, u1 + 1] - integral[v1 + 1, u0] + integral[v0, u0]


@kernel(parallel=True)
def carve_background(
    part: Part, occupied: NDArray[np.bool_], lattice: Lattice, cameras: Cameras, integrals: NDArray[np.int32]
) -> None:
    """Clear the voxels whose footprint, wholly inside some image, holds background alone."""
    nx, ny, nz = occupied.shape
    for i in span(part, nx):
        for j in range(ny):
            for k in range(nz):
                corner = corner_of(lattice, i, j, k)
                for view in range(integrals.shape[0]):
                    u0, u1, v0, v1, whole = footprint(cameras, view, corner, lattice.voxel_size)
                    if whole and _box_sum(integrals[view], u0, u1, v0, v1) == 0:
                        occupied[i, j, k] = False
                        break


@kernel(parallel=True)
def free_pixels(
    part: Part,
    voxels: NDArray[np.int64],
    lattice: Lattice,
    cameras: Cameras,
    integrals: NDArray[np.int32],
    free: NDArray[np.bool_],
    footprints: Footprints,
) -> None:
    """Footprint of every voxel (n, 3) in every view, its number of free pixels, and whether any foreground is in it."""
    boxes, counts, in_frame = footprints
    for n in span(part, voxels.shape[0]):
        corner = corner_of(lattice, voxels[n, 0], voxels[n, 1], voxels[n, 2])
        for view in range(boxes.shape[1]):
            u0, u1, v0, v1, _ = footprint(cameras, view, corner, lattice.voxel_size)
            boxes[n, view, 0] = u0
            boxes[n, view, 1] = u1
            boxes[n, view, 2] = v0
            boxes[n, view, 3] = v1
            count = 0
            if u0 <= u1 and v0 <= v1 and _box_sum(integrals[view], u0, u1, v0, v1) > 0:
                in_frame[n] = True
                for v in range(v0, v1 + 1):
                    for u in range(u0, u1 + 1):
                        count += free[view, v, u]
            counts[n, view] = count


@kernel(parallel=True)
def gather(
    part: Part, boxes: NDArray[np.int32], free: NDArray[np.bool_], images: NDArray[np.uint8], pixels: Pixels
) -> None:
    """Copy the free pixels of all footprints into one ragged array, voxel by voxel, view by view."""
    colors, view_starts = pixels
    for n in span(part, boxes.shape[0]):
        for view in range(boxes.shape[1]):
            target = view_starts[n, view]
            if target == view_starts[n, view + 1]:
                continue
            for v in range(boxes[n, view, 2], boxes[n, view, 3] + 1):
                for u in range(boxes[n, view, 0], boxes[n, view, 1] + 1):
                    if free[view, v, u]:
                        colors[target, 0] = images[view, v, u, 0]
                        colors[target, 1] = images[view, v, u, 1]
                        colors[target, 2] = images[view, v, u, 2]
                        target += 1


@kernel(parallel=True)
def mark(part: Part, boxes: NDArray[np.int32], accepted: NDArray[np.int64], free: NDArray[np.bool_]) -> None:
    """Take the pixels of the accepted voxels' footprints out of the free ones."""
    for view in span(part, boxes.shape[1]):
        for n in accepted:
            for v in range(boxes[n, view, 2], boxes[n, view, 3] + 1):
                for u in range(boxes[n, view, 0], boxes[n, view, 1] + 1):
                    free[view, v, u] = False
