"""Slanted windows: for every pixel the plane whose window agrees best with other views.

A plane is three numbers at a pixel: inverse depth there, and its slopes along u and v; over the image the inverse
depth of a plane is exactly linear.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.correlation import Plane, Samples, add_normal_equations, correlation, grid
from recon3d.kernels.types import Compared

NOTHING = 2.0
"""Cost where no window can be compared; 1 - NCC is at most that."""


_DAMPING = 1.02, 1.5  # of the normal equations' diagonal, for depth and for slopes


class WeightedWindow(NamedTuple):
    """What of the images is compared."""

    radius: int
    """Pixels from the middle to the sides."""
    spacing: int
    """Pixels between compared ones."""
    contrast: float
    """Grey levels of difference to the middle over which a pixel's weight falls to 1/e."""
    min_deviation: float
    """Grey levels; a window with less contrast has nothing to match."""


class Search(NamedTuple):
    """What a pixel's plane is looked for among, and in which views; rows and columns are the matched pixels'."""

    visible: NDArray[np.uint32]
    """(rows, columns) bit j: other view j sees what the pixel shows."""
    guide: NDArray[np.float32]
    """(height, width) inverse depth of the surface that the search starts from; 0 beside it."""
    tangents: NDArray[np.float32]
    """(rows, columns, 3) planes that touch it."""
    edge: float
    """Share of a pixel's inverse depth by which the guide leaves its tangent where another part of it begins."""
    nearest: NDArray[np.float32]
    """(rows, columns) least depth, world units."""
    farthest: NDArray[np.float32]
    """(rows, columns) largest depth, world units."""
    stride: int
    """Pixels between matched pixels."""
    most_views: int
    """The first so many that see a pixel are compared."""


class HalfSweep(NamedTuple):
    """Which half sweep over a view, and what it tries."""

    number: int
    """Even ones are of the pixels with an even sum of row and column; seeds the random trials."""
    ranges: NDArray[np.float64]
    """(n_trials, 2) largest change of inverse depth and of slope in each random trial; infinite: any depth."""
    steps: int = 1
    """Of Gauss and Newton from the best that the trials found."""


class Planes(NamedTuple):
    """The best planes so far."""

    planes: NDArray[np.float32]
    """(rows, columns, 3)."""
    costs: NDArray[np.float32]
    """(rows, columns) 1 - NCC in [0, 2]; ``NOTHING`` before the first sweep."""


@kernel(parallel=True)
def match_planes(
    part: Part, compared: Compared, window: WeightedWindow, search: Search, sweep: HalfSweep, found: Planes
) -> None:
    """Half a red-black sweep of PatchMatch: a pixel tries its neighbours' planes, then random ones around its best.

    Trials find the right one of several planes; steps of Gauss and Newton from there find its exact place.

    An even sweep is of the pixels with an even sum of row and column; they read only those with an odd one.
    """
    visible, guide, tangents, edge, nearest, farthest, stride, most_views = search
    number, ranges, steps = sweep
    planes, costs = found
    rows, columns = costs.shape
    width, height = compared.size[0], compared.size[1]
    half = window.radius // window.spacing
    reach = half * window.spacing
    count = (2 * half + 1) ** 2
    values, weights, chosen = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(most_views, np.int64)
    matrix, right = np.empty((3, 3)), np.empty(3)
    across, down = grid(half)
    for row in span(part, rows):
        state = np.uint64(row * 7919 + number * 104729 + 12345)
        for column in range((row + number) & 1, columns, 2):
            u = column * stride
            v = row * stride
            if visible[row, column] == 0 or u < reach or v < reach or u >= width - reach or v >= height - reach:
                continue
            _weigh_own_side(guide, _plane(tangents, row, column), u, v, edge, window, weights)
            level, power = _take_window(compared.image, u, v, window, values, weights)
            if power < window.min_deviation * window.min_deviation:
                continue
            own = Samples(values, weights, across, down, level, power, u, v, half, window.spacing)
            n_chosen = 0
            for j in range(compared.others.shape[0]):
                if n_chosen < most_views and (visible[row, column] >> np.uint32(j)) & np.uint32(1):
                    chosen[n_chosen] = j
                    n_chosen += 1
            low = 1.0 / farthest[row, column]
            high = 1.0 / nearest[row, column]
            best = _plane(planes, row, column)
            least = _cost(own, best, chosen[:n_chosen], compared, NOTHING)
            # Neighbours at odd distances have the other parity.
            for trial in range(8 + ranges.shape[0]):
                if trial < 8:
                    step = 1 - 2 * (trial & 1) if trial < 4 else 3 - 6 * (trial & 1)
                    dr = step if (trial >> 1) & 1 else 0
                    dc = step - dr
                    r = row + dr
                    c = column + dc
                    if r < 0 or c < 0 or r >= rows or c >= columns or costs[r, c] >= NOTHING:
                        continue
                    beside = _plane(planes, r, c)
                    wu, wv = beside.along_u, beside.along_v
                    w = beside.inverse_depth - stride * (wu * dc + wv * dr)
                else:
                    state, a = _random(state)
                    state, b = _random(state)
                    state, d = _random(state)
                    change = np.float32(ranges[trial - 8, 0])
                    w = (
                        best.inverse_depth + change * a
                        if change < np.inf
                        else low + np.float32(0.5) * (high - low) * (a + 1)
                    )
                    wu = best.along_u + np.float32(ranges[trial - 8, 1]) * b
                    wv = best.along_v + np.float32(ranges[trial - 8, 1]) * d
                if w < low or w > high:
                    continue
                plane = Plane(w, wu, wv)
                cost = _cost(own, plane, chosen[:n_chosen], compared, least)
                if cost < least:
                    least = cost
                    best = plane
            for _ in range(steps):
                plane = _stepped(own, best, chosen[:n_chosen], compared, matrix, right)
                if low <= plane.inverse_depth <= high:
                    cost = _cost(own, plane, chosen[:n_chosen], compared, least)
                    if cost < least:
                        least = cost
                        best = plane
            planes[row, column, 0] = best.inverse_depth
            planes[row, column, 1] = best.along_u
            planes[row, column, 2] = best.along_v
            costs[row, column] = least


@kernel()
def _plane(planes: NDArray[np.float32], row: int, column: int) -> Plane:
    """The plane of a pixel, in double precision."""
    return Plane(
        np.float64(planes[row, column, 0]), np.float64(planes[row, column, 1]), np.float64(planes[row, column, 2])
    )


@kernel()
def _weigh_own_side(
    guide: NDArray[np.float32],
    tangent: Plane,
    u: int,
    v: int,
    edge: float,
    window: WeightedWindow,
    weights: NDArray[np.float32],
) -> None:
    """Weights of a window's samples that fall to 0 where the guide leaves its tangent by an edge (Tukey's biweight)."""
    spacing = window.spacing
    half = window.radius // spacing
    at = 0
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            there = guide[v + dv * spacing, u + du * spacing]
            plane = tangent.inverse_depth + spacing * (tangent.along_u * du + tangent.along_v * dv)
            share = (there - plane) / (edge * tangent.inverse_depth)
            weights[at] = (1.0 - share * share) ** 2 if there > 0.0 and abs(share) < 1.0 else 0.0
            at += 1


@kernel()
def _take_window(
    image: NDArray[np.float32],
    u: int,
    v: int,
    window: WeightedWindow,
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> tuple[np.float32, np.float32]:
    """Window around a pixel less its mean, weights to a sum of one after they fall with distance and difference, too.

    Returns the weighted mean and variance.
    """
    spacing = window.spacing
    half = window.radius // spacing
    center = image[v, u]
    total = np.float32(0.0)
    mean = np.float32(0.0)
    at = 0
    for dv in range(-half, half + 1):
        for du in range(-half, half + 1):
            value = image[v + dv * spacing, u + du * spacing]
            far = np.float32((du * du + dv * dv) / (2.0 * half * half))
            values[at] = value
            weights[at] *= np.exp(-abs(value - center) / np.float32(window.contrast) - far)
            total += weights[at]
            mean += weights[at] * value
            at += 1
    mean /= total
    power = np.float32(0.0)
    for n in range(at):
        weights[n] /= total
        values[n] -= mean
        power += weights[n] * values[n] * values[n]
    return mean, power


@kernel()
def _random(state: np.uint64) -> tuple[np.uint64, np.float32]:
    """Next state of a 64-bit linear congruence, and a number in [-1, 1)."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return state, np.float32(np.int64(state >> np.uint64(33)) / 1073741824.0 - 1.0)


@kernel()
def _cost(own: Samples, plane: Plane, chosen: NDArray[np.int64], compared: Compared, least: float) -> float:
    """Mean of the two smallest 1 - NCC over the chosen views; the only one's where there is one.

    ``NOTHING`` where the last view could not bring it below ``least`` any more.
    """
    first = NOTHING
    second = NOTHING
    for n in range(len(chosen)):
        if 0 < n == len(chosen) - 1 and 0.5 * first >= least:
            return NOTHING
        cost = 1.0 - correlation(own, plane, compared, chosen[n])
        if cost < first:
            second = first
            first = cost
        elif cost < second:
            second = cost
    return first if len(chosen) == 1 else 0.5 * (first + second)


@kernel()
def _stepped(
    own: Samples,
    plane: Plane,
    chosen: NDArray[np.int64],
    compared: Compared,
    matrix: NDArray[np.float64],
    right: NDArray[np.float64],
) -> Plane:
    """A plane after a step of Gauss and Newton to a larger NCC with the two of the chosen views that agree best."""
    first = -1
    second = -1
    highest = -1.0
    higher = -1.0
    for n in range(len(chosen)):
        ncc = correlation(own, plane, compared, chosen[n])
        if ncc > highest:
            second, higher = first, highest
            first, highest = n, ncc
        elif ncc > higher:
            second, higher = n, ncc
    matrix[...] = 0.0
    right[...] = 0.0
    if first >= 0:
        add_normal_equations(own, plane, compared, chosen[first], matrix, right)
    if second >= 0:
        add_normal_equations(own, plane, compared, chosen[second], matrix, right)
    a, d, f = matrix[0, 0] * _DAMPING[0], matrix[1, 1] * _DAMPING[1], matrix[2, 2] * _DAMPING[1]
    b, c, e = matrix[0, 1], matrix[0, 2], matrix[1, 2]
    # Cramer's rule of a symmetric matrix.
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    if not determinant > 0.0:
        return plane
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    r, s, t = right
    dw = (A * r + B * s + C * t) / determinant
    du = (B * r + D * s + E * t) / determinant
    dv = (C * r + E * s + F * t) / determinant
    return Plane(plane.inverse_depth + dw, plane.along_u + du / own.spacing, plane.along_v + dv / own.spacing)
