"""A lattice in two levels: a dense grid of bricks, and the voxels of those bricks that are stored.

``slots`` (bx, by, bz) holds a brick's place among the stored ones, or EMPTY or SOLID; arrays of stored voxels are
(n, BRICK, BRICK, BRICK). Voxels beyond the lattice, in bricks that reach over its end, are stored and empty.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span

BRICK = 8
"""Voxels along a brick's edge."""
EMPTY, SOLID, UNDECIDED = -1, -2, -3
"""What ``slots`` says of bricks that are not stored."""


class StoredBricks(NamedTuple):
    """The bricks of a lattice."""

    slots: NDArray[np.int32]
    """(bx, by, bz) where each brick is stored in the arrays below; EMPTY or SOLID where it is not."""
    bricks: NDArray[np.int64]
    """(n_stored, 3) where each stored brick lies; its lowest voxel is BRICK times that."""
    occupied: NDArray[np.bool_]
    """(n_stored, BRICK, BRICK, BRICK)."""


@kernel()
def holds(slots: NDArray[np.int32], occupied: NDArray[np.bool_], i: int, j: int, k: int) -> bool:
    """Whether a voxel is occupied; none is outside the lattice."""
    if i < 0 or j < 0 or k < 0:
        return False
    bi, bj, bk = i // BRICK, j // BRICK, k // BRICK
    if bi >= slots.shape[0] or bj >= slots.shape[1] or bk >= slots.shape[2]:
        return False
    slot = slots[bi, bj, bk]
    if slot < 0:
        return slot == SOLID
    return occupied[slot, i % BRICK, j % BRICK, k % BRICK]


@kernel(parallel=True)
def copy_box(
    part: Part,
    slots: NDArray[np.int32],
    values: Any,
    low: NDArray[np.int64],
    when_empty: Any,
    when_solid: Any,
    box: Any,
) -> None:
    """Values of all voxels of a box whose lowest voxel is low, which may be negative; outside the lattice is empty."""
    for a in span(part, box.shape[0]):
        i = low[0] + a
        for b in range(box.shape[1]):
            j = low[1] + b
            for c in range(box.shape[2]):
                k = low[2] + c
                bi, bj, bk = i // BRICK, j // BRICK, k // BRICK
                slot = EMPTY
                if 0 <= bi < slots.shape[0] and 0 <= bj < slots.shape[1] and 0 <= bk < slots.shape[2]:
                    slot = slots[bi, bj, bk]
                if slot >= 0:
                    box[a, b, c] = values[slot, i % BRICK, j % BRICK, k % BRICK]
                else:
                    box[a, b, c] = when_solid if slot == SOLID else when_empty


@kernel(parallel=True)
def surface_voxels(part: Part, stored: StoredBricks, surface: NDArray[np.bool_]) -> None:
    """Occupied stored voxels with an empty face neighbour."""
    slots, bricks, occupied = stored
    for n in span(part, bricks.shape[0]):
        i0, j0, k0 = bricks[n, 0] * BRICK, bricks[n, 1] * BRICK, bricks[n, 2] * BRICK
        for a in range(BRICK):
            for b in range(BRICK):
                for c in range(BRICK):
                    i, j, k = i0 + a, j0 + b, k0 + c
                    surface[n, a, b, c] = occupied[n, a, b, c] and not (
                        holds(slots, occupied, i - 1, j, k)
                        and holds(slots, occupied, i + 1, j, k)
                        and holds(slots, occupied, i, j - 1, k)
                        and holds(slots, occupied, i, j + 1, k)
                        and holds(slots, occupied, i, j, k - 1)
                        and holds(slots, occupied, i, j, k + 1)
                    )


@kernel(parallel=True)
def exposed_bricks(
    part: Part, slots: NDArray[np.int32], occupied: NDArray[np.bool_], exposed: NDArray[np.bool_]
) -> None:
    """Solid bricks (bx, by, bz) with an empty voxel across one of their faces."""
    for bi in span(part, slots.shape[0]):
        for bj in range(slots.shape[1]):
            for bk in range(slots.shape[2]):
                if slots[bi, bj, bk] != SOLID:
                    continue
                for axis in range(3):
                    for side in range(2):
                        if _open_face(slots, occupied, (bi, bj, bk), axis, side):
                            exposed[bi, bj, bk] = True


@kernel()
def _open_face(
    slots: NDArray[np.int32], occupied: NDArray[np.bool_], brick: tuple[int, int, int], axis: int, side: int
) -> bool:
    """Whether an empty voxel lies across the lower (side 0) or upper (1) face of a brick."""
    bi, bj, bk = brick
    across = BRICK if side else -1
    for b in range(BRICK):
        for c in range(BRICK):
            i = bi * BRICK + (across if axis == 0 else b)
            j = bj * BRICK + (across if axis == 1 else b if axis == 0 else c)
            k = bk * BRICK + (across if axis == 2 else c)
            if not holds(slots, occupied, i, j, k):
                return True
    return False


@kernel()
def grow_support(
    stored: StoredBricks,
    visible: NDArray[np.bool_],
    offsets: NDArray[np.int64],
    supported: NDArray[np.bool_],
    seeds: NDArray[np.int64],
    capacity: int,
) -> None:
    """Mark (flat, stored voxels) the visible voxels that visible ones connect to a seed; seeds are marked already.

    capacity is the number of visible voxels.
    """
    slots, bricks, _ = stored
    stack = np.empty(capacity, np.int64)
    depth = len(seeds)
    stack[:depth] = seeds
    while depth > 0:
        depth -= 1
        slot, local = stack[depth] // BRICK**3, stack[depth] % BRICK**3
        i = bricks[slot, 0] * BRICK + local // BRICK**2
        j = bricks[slot, 1] * BRICK + local // BRICK % BRICK
        k = bricks[slot, 2] * BRICK + local % BRICK
        for o in range(offsets.shape[0]):
            a, b, c = i + offsets[o, 0], j + offsets[o, 1], k + offsets[o, 2]
            if a < 0 or b < 0 or c < 0:
                continue
            bi, bj, bk = a // BRICK, b // BRICK, c // BRICK
            if bi >= slots.shape[0] or bj >= slots.shape[1] or bk >= slots.shape[2] or slots[bi, bj, bk] < 0:
                continue
            place = ((slots[bi, bj, bk] * BRICK + a % BRICK) * BRICK + b % BRICK) * BRICK + c % BRICK
            if visible[place] and not supported[place]:
                supported[place] = True
                stack[depth] = place
                depth += 1
