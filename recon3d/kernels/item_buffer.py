"""The item buffer: per view and pixel, the first occupied voxel on the pixel's ray.

Carving only removes voxels, so a ray's hit only moves on: a ray is its current voxel, -1 where it has left the volume,
and the next voxel follows from the index and the ray alone, without rounding that would add up.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.types import Cameras, Lattice, Pixels, Ray


@kernel(parallel=True)
def enter_volume(
    part: Part, lattice: Lattice, cameras: Cameras, wanted: NDArray[np.bool_], items: NDArray[np.int32]
) -> None:
    """First voxel of every wanted pixel's ray in the volume, or -1; from a camera inside it, the camera's own."""
    n_views, height, width = items.shape
    ray = Ray(np.empty(3), np.empty(3), np.empty(3, np.int64))
    place = ray.place
    _, ny, nz = lattice.shape
    for line in span(part, n_views * height):
        view = line // height
        row = line % height
        for column in range(width):
            items[view, row, column] = -1
            if wanted[view, row, column]:
                start_ray(lattice, cameras, view, column, row, ray)
                if enter_box(lattice.shape, ray):
                    items[view, row, column] = (place[0] * ny + place[1]) * nz + place[2]


@kernel(parallel=True)
def advance(
    part: Part,
    occupied: NDArray[np.bool_],
    lattice: Lattice,
    cameras: Cameras,
    items: NDArray[np.int32],
    touched: NDArray[np.bool_],
) -> None:
    """Move every ray on to its first occupied voxel, and mark in touched (flat) the voxels that rays newly hit."""
    n_views, height, width = items.shape
    _, ny, nz = lattice.shape
    flat = occupied.ravel()
    ray = Ray(np.empty(3), np.empty(3), np.empty(3, np.int64))
    place = ray.place
    for line in span(part, n_views * height):
        view = line // height
        row = line % height
        for column in range(width):
            item = items[view, row, column]
            if item < 0 or flat[item]:
                continue
            place[0] = item // (ny * nz)
            place[1] = item // nz % ny
            place[2] = item % nz
            start_ray(lattice, cameras, view, column, row, ray)
            item = _next_occupied(flat, lattice.shape, ray)
            items[view, row, column] = item
            if item >= 0:
                touched[item] = True


@kernel()
def start_ray(lattice: Lattice, cameras: Cameras, view: int, u: int, v: int, ray: Ray) -> None:
    """Set where a pixel's ray starts, and its direction."""
    x, y, z = lattice.origin
    size, center, M = lattice.voxel_size, cameras.centers[view], cameras.world_from_pixel[view]
    start, step, _ = ray
    start[0] = (center[0] - x) / size
    start[1] = (center[1] - y) / size
    start[2] = (center[2] - z) / size
    for axis in range(3):
        step[axis] = M[axis, 0] * u + M[axis, 1] * v + M[axis, 2]


@kernel()
def enter_box(shape: Any, ray: Ray) -> bool:
    """Set the first voxel of a ray in the lattice, the start's own if that is inside; false where it misses."""
    start, step, place = ray
    near = 0.0
    far = np.inf
    for axis in range(3):
        if step[axis] == 0.0:
            if start[axis] < 0 or start[axis] >= shape[axis]:
                return False
            continue
        first = -start[axis] / step[axis]
        second = (shape[axis] - start[axis]) / step[axis]
        near = max(near, min(first, second))
        far = min(far, max(first, second))
    if not near < far:
        return False
    for axis in range(3):
        entry = int(np.floor(start[axis] + near * step[axis]))
        place[axis] = min(max(entry, 0), shape[axis] - 1)
    return True


@kernel()
def next_voxel(shape: Any, ray: Ray) -> bool:
    """Step across the voxel's first wall on the ray, of equal ones that of the lower axis; false beyond the lattice."""
    start, step, place = ray
    axis = -1
    nearest = np.inf
    for a in range(3):
        if step[a] != 0.0:
            wall = place[a] + 1 if step[a] > 0 else place[a]
            crossing = (wall - start[a]) / step[a]
            if crossing < nearest:
                nearest = crossing
                axis = a
    if axis < 0:
        return False
    place[axis] += 1 if step[axis] > 0 else -1
    return 0 <= place[axis] < shape[axis]


@kernel()
def _next_occupied(flat: Any, shape: Any, ray: Ray) -> int:
    """Walk from an empty voxel along a ray to the next occupied one; -1 beyond the volume."""
    place = ray.place
    while True:
        if not next_voxel(shape, ray):
            return -1
        index = (place[0] * shape[1] + place[1]) * shape[2] + place[2]
        if flat[index]:
            return index


@kernel(parallel=True)
def count_items(part: Part, items: NDArray[np.int32], rank: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
    """Pixels of every ranked voxel in every view, (n, n_views); rank (flat) is -1 for voxels not asked for."""
    for view in span(part, items.shape[0]):
        for row in range(items.shape[1]):
            for column in range(items.shape[2]):
                item = items[view, row, column]
                if item >= 0 and rank[item] >= 0:
                    counts[rank[item], view] += 1


@kernel(parallel=True)
def collect_items(
    part: Part,
    items: NDArray[np.int32],
    rank: NDArray[np.int32],
    images: NDArray[np.uint8],
    pixels: Pixels,
) -> None:
    """Second pass of the counting sort: the colours of every ranked voxel's pixels, view by view."""
    colors, view_starts = pixels
    for view in span(part, items.shape[0]):
        filled = view_starts[:, view].copy()
        for row in range(items.shape[1]):
            for column in range(items.shape[2]):
                item = items[view, row, column]
                if item >= 0 and rank[item] >= 0:
                    target = filled[rank[item]]
                    filled[rank[item]] += 1
                    for channel in range(3):
                        colors[target, channel] = images[view, row, column, channel]
