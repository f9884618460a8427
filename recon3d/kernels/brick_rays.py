"""The item buffer on a lattice of bricks: the voxels that rays meet are those of a dense lattice, to the last bit.

A ray is the stored voxel that it sees, flat; NOT_ENTERED before its first walk, and GONE when it has left the lattice.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.bricks import BRICK, SOLID, StoredBricks
from recon3d.kernels.item_buffer import enter_box, next_voxel, start_ray
from recon3d.kernels.types import Cameras, Lattice, Ray

GONE, NOT_ENTERED = -1, -2
_MET_SOLID = -3


@kernel(parallel=True)
def advance_bricks(
    part: Part,
    lattice: Lattice,
    stored: StoredBricks,
    cameras: Cameras,
    items: NDArray[np.int32],
    touched: NDArray[np.bool_],
    missing: NDArray[np.bool_],
) -> None:
    """Move every ray on to its first occupied voxel, and mark in touched (flat) the stored voxels newly hit.

    A ray that meets a solid brick stays as it is and marks the brick (bx, by, bz) in missing: store it, call again.
    """
    n_views, height, width = items.shape
    slots, bricks, occupied = stored
    flat = occupied.ravel()
    ray = Ray(np.empty(3), np.empty(3), np.empty(3, np.int64))
    place = ray.place
    for line in span(part, n_views * height):
        view = line // height
        row = line % height
        for column in range(width):
            item = items[view, row, column]
            if item == GONE or (item >= 0 and flat[item]):
                continue
            start_ray(lattice, cameras, view, column, row, ray)
            if item >= 0:
                slot, local = item // BRICK**3, item % BRICK**3
                place[0] = bricks[slot, 0] * BRICK + local // BRICK**2
                place[1] = bricks[slot, 1] * BRICK + local // BRICK % BRICK
                place[2] = bricks[slot, 2] * BRICK + local % BRICK
            elif not enter_box(lattice.shape, ray):
                items[view, row, column] = GONE
                continue
            item = _first_occupied(lattice.shape, slots, flat, ray)
            if item == _MET_SOLID:
                missing[place[0] // BRICK, place[1] // BRICK, place[2] // BRICK] = True
                continue
            items[view, row, column] = item
            if item >= 0:
                touched[item] = True


@kernel()
def _first_occupied(shape: Any, slots: Any, flat: Any, ray: Ray) -> int:
    """Walk along a ray to its first occupied voxel, this one included; GONE beyond the lattice."""
    place = ray.place
    while True:
        slot = slots[place[0] // BRICK, place[1] // BRICK, place[2] // BRICK]
        if slot == SOLID:
            return _MET_SOLID
        if slot >= 0:
            item = ((slot * BRICK + place[0] % BRICK) * BRICK + place[1] % BRICK) * BRICK + place[2] % BRICK
            if flat[item]:
                return item
            inside = next_voxel(shape, ray)
        else:
            inside = next_brick(shape, ray)
        if not inside:
            return GONE


@kernel()
def next_brick(shape: Any, ray: Ray) -> bool:
    """Step to the ray's first voxel beyond the brick of its place, as ``next_voxel`` over and over; false if none is.

    That crosses walls in order of where the ray meets them, then of axis, so the wall that ends the brick tells which
    others have been crossed; rounding is the same since every crossing is computed alike.
    """
    start, step, place = ray
    axis = -1
    nearest = np.inf
    for a in range(3):
        if step[a] != 0.0:
            low = place[a] // BRICK * BRICK
            wall = min(low + BRICK, shape[a]) if step[a] > 0 else low
            crossing = (wall - start[a]) / step[a]
            if crossing < nearest:
                nearest = crossing
                axis = a
    if axis < 0:
        return False
    for a in range(3):
        if a == axis or step[a] == 0.0:
            continue
        low = place[a] // BRICK * BRICK
        guess = np.floor(start[a] + nearest * step[a])
        if step[a] > 0:
            at = int(min(max(guess, float(place[a])), float(low + BRICK - 1)))
            while at > place[a] and not _before(at, start[a], step[a], nearest, a < axis):
                at -= 1
            while _before(at + 1, start[a], step[a], nearest, a < axis):
                at += 1
        else:
            at = int(min(max(guess, float(low)), float(place[a])))
            while at < place[a] and not _before(at + 1, start[a], step[a], nearest, a < axis):
                at += 1
            while _before(at, start[a], step[a], nearest, a < axis):
                at -= 1
        place[a] = at
    low = place[axis] // BRICK * BRICK
    place[axis] = min(low + BRICK, shape[axis]) if step[axis] > 0 else low - 1
    return 0 <= place[axis] < shape[axis]


@kernel()
def _before(wall: int, start: float, step: float, nearest: float, first_if_equal: bool) -> bool:
    """Whether the ray meets a wall of one axis before its nearest wall of another."""
    crossing = (wall - start) / step
    return crossing < nearest or (first_if_equal and crossing == nearest)
