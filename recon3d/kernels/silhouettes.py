"""Signed distance to silhouettes, sampled at voxel centres."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.bricks import BRICK, EMPTY, SOLID, UNDECIDED
from recon3d.kernels.cameras import bilinear, project
from recon3d.kernels.lattice import center_of
from recon3d.kernels.types import Cameras, Lattice


class Outlines(NamedTuple):
    """The silhouettes of the views that have one."""

    cameras: Cameras
    """Of these views."""
    pixel_scales: NDArray[np.float64]
    """(n_views,) a pixel's size at depth one, world units."""
    distances: NDArray[np.float32]
    """(n_views, height, width) signed distance to the outline, pixels, positive inside."""
    tolerance: int
    """How many of them may be wrong about a place."""


@kernel(parallel=True)
def silhouette_distance(part: Part, lattice: Lattice, outlines: Outlines, field: NDArray[np.float32]) -> None:
    """Signed distance of every voxel's centre to the outlines, world units, where that is below what field holds.

    Of the views that show the centre the smallest, those aside that may be wrong; with no more views field keeps its
    value.
    """
    nx, ny, nz = field.shape
    smallest = np.empty(outlines.tolerance + 1, np.float64)
    for i in span(part, nx):
        for j in range(ny):
            for k in range(nz):
                value = distance_at(outlines, center_of(lattice, i, j, k), smallest)
                if value < field[i, j, k]:
                    field[i, j, k] = value


@kernel()
def distance_at(outlines: Outlines, point: tuple[float, float, float], smallest: NDArray[np.float64]) -> float:
    """The len(smallest)-th smallest signed distance over the views that show a point; infinite with fewer views."""
    smallest[:] = np.inf
    for view in range(outlines.distances.shape[0]):
        value = distance_in(outlines, view, point)
        for rank in range(smallest.shape[0]):
            if value < smallest[rank]:
                smallest[rank], value = value, smallest[rank]
    return smallest[-1]


@kernel()
def distance_in(outlines: Outlines, view: int, point: tuple[float, float, float]) -> float:
    """Signed distance of a point to a view's outline, world units; infinite where the view does not show the point."""
    x, y, z = point
    u, v, depth = project(outlines.cameras.projections[view], x, y, z)
    width, height = outlines.cameras.sizes[view, 0], outlines.cameras.sizes[view, 1]
    if not (depth > 0.0 and u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5):
        return np.inf
    return bilinear(outlines.distances[view], u, v, width, height) * depth * outlines.pixel_scales[view]


@kernel(parallel=True)
def bound_bricks(part: Part, lattice: Lattice, outlines: Outlines, limit: float, slots: NDArray[np.int32]) -> None:
    """Slots (bx, by, bz): EMPTY or SOLID where no voxel of the brick can be within the limit, else UNDECIDED.

    Neighbouring pixels of a signed distance differ by one at most, so that over a brick's footprint it differs from
    its middle by at most half the footprint's width and height together. At specks and pinholes, which are kept on
    their side of the outline, they differ by a little more: far less than the limit, three voxels.
    """
    cameras, pixel_scales, distances, tolerance = outlines
    projections, sizes = cameras.projections, cameras.sizes
    shape = lattice.shape
    limit = limit * (1 + 1e-6)
    for column in span(part, slots.shape[0] * slots.shape[1]):
        for bk in range(slots.shape[2]):
            bi, bj = column // slots.shape[1], column % slots.shape[1]
            whole_brick = max(bi + 1 - shape[0] / BRICK, bj + 1 - shape[1] / BRICK, bk + 1 - shape[2] / BRICK) <= 0
            outside = 0
            doubtful = 0
            for view in range(projections.shape[0]):
                u_min = v_min = near = np.inf
                u_max = v_max = far = -np.inf
                for corner in range(8):
                    # Centres of the brick's outermost voxels.
                    i = min(bi * BRICK + (BRICK - 1) * (corner & 1), shape[0] - 1)
                    j = min(bj * BRICK + (BRICK - 1) * ((corner >> 1) & 1), shape[1] - 1)
                    k = min(bk * BRICK + (BRICK - 1) * (corner >> 2), shape[2] - 1)
                    x, y, z = center_of(lattice, i, j, k)
                    u, v, depth = project(projections[view], x, y, z)
                    near = min(near, depth)
                    far = max(far, depth)
                    if depth > 0.0:
                        u_min, u_max = min(u_min, u), max(u_max, u)
                        v_min, v_max = min(v_min, v), max(v_max, v)
                if far <= 0.0:
                    continue  # wholly behind the camera
                if near <= 0.0:
                    doubtful += 1
                    continue
                width, height = sizes[view, 0], sizes[view, 1]
                if u_max < -0.5 or v_max < -0.5 or u_min >= width - 0.5 or v_min >= height - 0.5:
                    continue  # not in the image
                whole = u_min >= -0.499 and v_min >= -0.499 and u_max < width - 0.501 and v_max < height - 0.501
                middle = bilinear(distances[view], 0.5 * (u_min + u_max), 0.5 * (v_min + v_max), width, height)
                reach = 0.5 * (u_max - u_min + v_max - v_min) + 1e-3
                highest = (middle + reach) * pixel_scales[view] * (near if middle + reach < 0 else far)
                lowest = (middle - reach) * pixel_scales[view] * (far if middle - reach < 0 else near)
                if whole and highest <= -limit:
                    outside += 1
                elif lowest < limit:
                    doubtful += 1
            if outside > tolerance:
                slots[bi, bj, bk] = EMPTY
            elif outside + doubtful <= tolerance and whole_brick:
                slots[bi, bj, bk] = SOLID
            else:
                slots[bi, bj, bk] = UNDECIDED


@kernel(parallel=True)
def sample_bricks(
    part: Part,
    bricks: NDArray[np.int64],
    lattice: Lattice,
    outlines: Outlines,
    limit: float,
    field: NDArray[np.float32],
    kinds: NDArray[np.int32],
) -> None:
    """Field (n, BRICK, BRICK, BRICK) of bricks (n, 3), cut off at the limit on either side; the lowest off the lattice.

    A field of no bricks asks for the kinds alone: EMPTY or SOLID where the whole brick is at the limit, else UNDECIDED.
    """
    limit32 = np.float32(limit)
    nx, ny, nz = lattice.shape
    smallest = np.empty(outlines.tolerance + 1, np.float64)
    for n in span(part, bricks.shape[0]):
        n_in = n_out = 0
        for local in range(BRICK**3):
            a, b, c = local // BRICK**2, local // BRICK % BRICK, local % BRICK
            i, j, k = bricks[n, 0] * BRICK + a, bricks[n, 1] * BRICK + b, bricks[n, 2] * BRICK + c
            value = -limit32
            if i < nx and j < ny and k < nz:
                exact = distance_at(outlines, center_of(lattice, i, j, k), smallest)
                value = max(np.float32(min(exact, np.float64(limit32))), -limit32)
            n_in += int(value >= limit32)
            n_out += int(value <= -limit32)
            if field.shape[0]:
                field[n, a, b, c] = value
            elif max(n_in, n_out) <= local:
                break
        kinds[n] = SOLID if n_in == BRICK**3 else EMPTY if n_out == BRICK**3 else UNDECIDED
