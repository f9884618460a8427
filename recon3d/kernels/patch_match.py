"""Slanted windows: for every pixel the plane whose window agrees best with other views.

A plane is three numbers at a pixel: inverse depth there, and its slopes along u and v; over the image the inverse
depth of a plane is exactly linear.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.types import Compared

NOTHING = 2.0
"""Cost where no window can be compared; 1 - NCC is at most that."""


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


class Planes(NamedTuple):
    """The best planes so far."""

    planes: NDArray[np.float32]
    """(rows, columns, 3)."""
    costs: NDArray[np.float32]
    """(rows, columns) 1 - NCC in [0, 2]; ``NOTHING`` before the first sweep."""


class Plane(NamedTuple):
    """A plane as a pixel sees it."""

    inverse_depth: float
    """At the pixel, 1 / world units."""
    along_u: float
    """Change of inverse depth a column."""
    along_v: float
    """Change of inverse depth a row."""


class _Samples(NamedTuple):
    """A pixel's own window."""

    values: NDArray[np.float32]
    """(count,) grey levels less their weighted mean, row by row."""
    weights: NDArray[np.float32]
    """(count,) of sum one."""
    power: np.float32
    """Weighted variance."""
    u: int
    """Column of the pixel."""
    v: int
    """Row of the pixel."""
    half: int
    """Samples from the middle to the sides."""
    spacing: int
    """Pixels between samples."""


@kernel(parallel=True)
def match_planes(
    part: Part, compared: Compared, window: WeightedWindow, search: Search, sweep: HalfSweep, found: Planes
) -> None:
    """Half a red-black sweep of PatchMatch: a pixel tries its neighbours' planes, then random ones around its best.

    An even sweep is of the pixels with an even sum of row and column; they read only those with an odd one.
    """
    visible, nearest, farthest, stride, most_views = search
    number, ranges = sweep
    planes, costs = found
    rows, columns = costs.shape
    width, height = compared.size[0], compared.size[1]
    half = window.radius // window.spacing
    reach = half * window.spacing
    count = (2 * half + 1) ** 2
    values, weights, chosen = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(most_views, np.int64)
    for row in span(part, rows):
        state = np.uint64(row * 7919 + number * 104729 + 12345)
        for column in range((row + number) & 1, columns, 2):
            u = column * stride
            v = row * stride
            if visible[row, column] == 0 or u < reach or v < reach or u >= width - reach or v >= height - reach:
                continue
            power = _take_window(compared.image, u, v, window, values, weights)
            if power < window.min_deviation * window.min_deviation:
                continue
            own = _Samples(values, weights, power, u, v, half, window.spacing)
            n_chosen = 0
            for j in range(compared.others.shape[0]):
                if n_chosen < most_views and (visible[row, column] >> np.uint32(j)) & np.uint32(1):
                    chosen[n_chosen] = j
                    n_chosen += 1
            low = 1.0 / farthest[row, column]
            high = 1.0 / nearest[row, column]
            best = _plane(planes, row, column)
            least = _cost(own, best, chosen[:n_chosen], compared)
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
                cost = _cost(own, plane, chosen[:n_chosen], compared)
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
def _take_window(
    image: NDArray[np.float32],
    u: int,
    v: int,
    window: WeightedWindow,
    values: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> np.float32:
    """Window around a pixel less its mean, weights of sum one that fall with distance and difference; its variance."""
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
            weights[at] = np.exp(-abs(value - center) / np.float32(window.contrast) - far)
            total += weights[at]
            mean += weights[at] * value
            at += 1
    mean /= total
    power = np.float32(0.0)
    for n in range(at):
        weights[n] /= total
        values[n] -= mean
        power += weights[n] * values[n] * values[n]
    return power


@kernel()
def _random(state: np.uint64) -> tuple[np.uint64, np.float32]:
    """Next state of a 64-bit linear congruence, and a number in [-1, 1)."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return state, np.float32(np.int64(state >> np.uint64(33)) / 1073741824.0 - 1.0)


@kernel()
def _cost(own: _Samples, plane: Plane, chosen: NDArray[np.int64], compared: Compared) -> float:
    """Mean of the two smallest 1 - NCC over the chosen views; the only one's where there is one."""
    first = NOTHING
    second = NOTHING
    for j in chosen:
        cost = 1.0 - _correlation(own, plane, compared, j)
        if cost < first:
            second = first
            first = cost
        elif cost < second:
            second = cost
    return first if len(chosen) == 1 else 0.5 * (first + second)


@kernel()
def _correlation(own: _Samples, plane: Plane, compared: Compared, j: int) -> float:
    """Weighted NCC of a window with its image in another view; -1 where that leaves the view.

    Within a window the plane's homography is as good as its affine part, which needs no division a sample.
    """
    values, weights, power, u, v, half, spacing = own
    w, wu, wv = plane
    H, e, other = compared.homographies[j], compared.epipoles[j], compared.others[j]
    width, height = compared.other_sizes[j, 0], compared.other_sizes[j, 1]
    z = H[2, 0] * u + H[2, 1] * v + H[2, 2] + w * e[2]
    if z <= 0.0:
        return -1.0
    x = (H[0, 0] * u + H[0, 1] * v + H[0, 2] + w * e[0]) / z
    y = (H[1, 0] * u + H[1, 1] * v + H[1, 2] + w * e[1]) / z
    zu = H[2, 0] + wu * e[2]
    zv = H[2, 1] + wv * e[2]
    xu = (H[0, 0] + wu * e[0] - x * zu) / z * spacing
    xv = (H[0, 1] + wv * e[0] - x * zv) / z * spacing
    yu = (H[1, 0] + wu * e[1] - y * zu) / z * spacing
    yv = (H[1, 1] + wv * e[1] - y * zv) / z * spacing
    wide = half * (abs(xu) + abs(xv)) + 1e-3
    high = half * (abs(yu) + abs(yv)) + 1e-3
    if not (x >= wide and y >= high and x + wide < width - 1.0 and y + high < height - 1.0):
        return -1.0
    mean = 0.0
    square = 0.0
    product = 0.0
    at = 0
    for dv in range(-half, half + 1):
        a = x + dv * xv - half * xu
        b = y + dv * yv - half * yu
        for _ in range(2 * half + 1):
            column = int(a)
            row = int(b)
            s = a - column
            t = b - row
            top = other[row, column] + s * (other[row, column + 1] - other[row, column])
            bottom = other[row + 1, column] + s * (other[row + 1, column + 1] - other[row + 1, column])
            value = top + t * (bottom - top)
            weighted = weights[at] * value
            mean += weighted
            square += weighted * value
            product += weighted * values[at]
            at += 1
            a += xu
            b += yu
    variance = square - mean * mean
    if variance < 0.25:
        return -1.0
    return product / np.sqrt(power * variance)
