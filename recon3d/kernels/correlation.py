"""Normalised cross-correlation of a view's window with its image, over a plane, in another view."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel
from recon3d.kernels.types import Compared

OUTSIDE = -2.0
"""Instead of a correlation: the window leaves the other view, or lies behind it."""

_LEAST_VARIANCE = np.float32(0.25)  # grey levels squared of the other window; with less there is nothing to match

_MARGIN = 0.01  # pixels to the border, more than single precision rounds places of a window off by


class Plane(NamedTuple):
    """A plane as a pixel sees it."""

    inverse_depth: float
    """At the pixel, 1 / world units."""
    along_u: float
    """Change of inverse depth a column."""
    along_v: float
    """Change of inverse depth a row."""


class Samples(NamedTuple):
    """A pixel's own window."""

    values: NDArray[np.float32]
    """(count,) grey levels less their weighted mean."""
    weights: NDArray[np.float32]
    """(count,) of sum one."""
    across: NDArray[np.float32]
    """(count,) columns from the middle, in spacings."""
    down: NDArray[np.float32]
    """(count,) rows from the middle, in spacings."""
    level: np.float32
    """Their weighted mean, grey levels."""
    power: np.float32
    """Their weighted variance."""
    u: int
    """Column of the pixel."""
    v: int
    """Row of the pixel."""
    half: int
    """Samples from the middle to the sides."""
    spacing: int
    """Pixels between samples."""


@kernel()
def grid(half: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows (count,) of a window's samples from its middle, row by row."""
    side = 2 * half + 1
    place = np.arange(side * side)
    return (place % side - half).astype(np.float32), (place // side - half).astype(np.float32)


@kernel(regrouped=True)
def correlation(own: Samples, plane: Plane, compared: Compared, j: int) -> float:
    """Weighted NCC of a window with its image in view j; -1 where that is flat, ``OUTSIDE`` where it leaves the view.

    Within a window the plane's homography is as good as its affine part, which needs no division a sample. Single
    precision, flat indexes without a sign and sums in any order let the processor take several samples at once.
    """
    values, weights, across, down, level, power, u, v, half, spacing = own
    w, wu, wv = plane
    H, e = compared.homographies[j], compared.epipoles[j]
    width, height = compared.other_sizes[j, 0], compared.other_sizes[j, 1]
    z = H[2, 0] * u + H[2, 1] * v + H[2, 2] + w * e[2]
    if z <= 0.0:
        return OUTSIDE
    x = (H[0, 0] * u + H[0, 1] * v + H[0, 2] + w * e[0]) / z
    y = (H[1, 0] * u + H[1, 1] * v + H[1, 2] + w * e[1]) / z
    zu = H[2, 0] + wu * e[2]
    zv = H[2, 1] + wv * e[2]
    xu = (H[0, 0] + wu * e[0] - x * zu) / z * spacing
    xv = (H[0, 1] + wv * e[0] - x * zv) / z * spacing
    yu = (H[1, 0] + wu * e[1] - y * zu) / z * spacing
    yv = (H[1, 1] + wv * e[1] - y * zv) / z * spacing
    wide = half * (abs(xu) + abs(xv)) + _MARGIN
    high = half * (abs(yu) + abs(yv)) + _MARGIN
    if not (x >= wide and y >= high and x + wide < width - 1.0 and y + high < height - 1.0):
        return OUTSIDE
    other = compared.others[j].reshape(-1)
    stride = np.uint32(compared.others.shape[2])
    left, top = np.float32(x), np.float32(y)
    left_u, left_v, top_u, top_v = np.float32(xu), np.float32(xv), np.float32(yu), np.float32(yv)
    mean = np.float32(0.0)
    square = np.float32(0.0)
    product = np.float32(0.0)
    for n in range(values.shape[0]):
        a = left + across[n] * left_u + down[n] * left_v
        b = top + across[n] * top_u + down[n] * top_v
        column, row = np.int32(a), np.int32(b)
        s = a - np.float32(column)
        t = b - np.float32(row)
        at = np.uint32(np.uint32(row) * stride + np.uint32(column))
        below = np.uint32(at + stride)
        upper = other[at] + s * (other[np.uint32(at + np.uint32(1))] - other[at])
        lower = other[below] + s * (other[np.uint32(below + np.uint32(1))] - other[below])
        value = upper + t * (lower - upper) - level
        weighted = weights[n] * value
        mean += weighted
        square += weighted * value
        product += weighted * values[n]
    variance = square - mean * mean
    if variance < _LEAST_VARIANCE:
        return -1.0
    return product / np.sqrt(power * variance)
