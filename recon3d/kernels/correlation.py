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


class Placed(NamedTuple):
    """Where a window lies in another view: its middle, and changes a spacing along u and v and an inverse depth."""

    inside: bool
    """Whether all of it does."""
    x: float
    y: float
    xu: float
    xv: float
    xw: float
    yu: float
    yv: float
    yw: float


@kernel()
def place(own: Samples, plane: Plane, compared: Compared, j: int) -> Placed:
    """Where a window on a plane lies in view j.

    Within a window the plane's homography is as good as its affine part, which needs no division a sample.
    """
    H, e = compared.homographies[j], compared.epipoles[j]
    u, v, w = own.u, own.v, plane.inverse_depth
    z = H[2, 0] * u + H[2, 1] * v + H[2, 2] + w * e[2]
    if z <= 0.0:
        return Placed(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x = (H[0, 0] * u + H[0, 1] * v + H[0, 2] + w * e[0]) / z
    y = (H[1, 0] * u + H[1, 1] * v + H[1, 2] + w * e[1]) / z
    zu = H[2, 0] + plane.along_u * e[2]
    zv = H[2, 1] + plane.along_v * e[2]
    xu = (H[0, 0] + plane.along_u * e[0] - x * zu) / z * own.spacing
    xv = (H[0, 1] + plane.along_v * e[0] - x * zv) / z * own.spacing
    yu = (H[1, 0] + plane.along_u * e[1] - y * zu) / z * own.spacing
    yv = (H[1, 1] + plane.along_v * e[1] - y * zv) / z * own.spacing
    xw = (e[0] - x * e[2]) / z
    yw = (e[1] - y * e[2]) / z
    wide = own.half * (abs(xu) + abs(xv)) + _MARGIN
    high = own.half * (abs(yu) + abs(yv)) + _MARGIN
    right, bottom = compared.other_sizes[j, 0] - 1.0, compared.other_sizes[j, 1] - 1.0
    inside = x >= wide and y >= high and x + wide < right and y + high < bottom
    return Placed(inside, x, y, xu, xv, xw, yu, yv, yw)


@kernel(regrouped=True)
def correlation(own: Samples, plane: Plane, compared: Compared, j: int) -> float:
    """Weighted NCC of a window with its image in view j; -1 where that is flat, ``OUTSIDE`` where it leaves the view.

    Single precision, flat indexes without a sign and sums in any order let the processor take several samples at once.
    """
    placed = place(own, plane, compared, j)
    if not placed.inside:
        return OUTSIDE
    values, weights, across, down, level = own.values, own.weights, own.across, own.down, own.level
    other = compared.others[j].reshape(-1)
    stride = np.uint32(compared.others.shape[2])
    left, left_u, left_v = np.float32(placed.x), np.float32(placed.xu), np.float32(placed.xv)
    top, top_u, top_v = np.float32(placed.y), np.float32(placed.yu), np.float32(placed.yv)
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
    return product / np.sqrt(own.power * variance)


@kernel(regrouped=True)
def add_normal_equations(
    own: Samples, plane: Plane, compared: Compared, j: int, matrix: NDArray[np.float64], right: NDArray[np.float64]
) -> None:
    """Add view j's part to the normal equations (3, 3) and (3,) of the step that raises a plane's NCC.

    Least squares of the own window less the other one, whose level and contrast are fitted besides, linear in inverse
    depth and its slopes a spacing (Gauss-Newton).
    """
    placed = place(own, plane, compared, j)
    if not placed.inside:
        return
    values, weights, across, down, level = own.values, own.weights, own.across, own.down, own.level
    other = compared.others[j].reshape(-1)
    stride = np.uint32(compared.others.shape[2])
    left, left_u, left_v = np.float32(placed.x), np.float32(placed.xu), np.float32(placed.xv)
    top, top_u, top_v = np.float32(placed.y), np.float32(placed.yu), np.float32(placed.yv)
    left_w, top_w = np.float32(placed.xw), np.float32(placed.yw)
    zero = np.float32(0.0)
    mean = square = product = zero
    q = qu = qv = qb = qub = qvb = qa = qua = qva = zero
    qq = qqu = qqv = qquu = qquv = qqvv = zero
    for n in range(values.shape[0]):
        a = left + across[n] * left_u + down[n] * left_v
        b = top + across[n] * top_u + down[n] * top_v
        column, row = np.int32(a), np.int32(b)
        s = a - np.float32(column)
        t = b - np.float32(row)
        at = np.uint32(np.uint32(row) * stride + np.uint32(column))
        below = np.uint32(at + stride)
        upper_step = other[np.uint32(at + np.uint32(1))] - other[at]
        lower_step = other[np.uint32(below + np.uint32(1))] - other[below]
        upper = other[at] + s * upper_step
        lower = other[below] + s * lower_step
        value = upper + t * (lower - upper) - level
        slope = (upper_step + t * (lower_step - upper_step)) * left_w + (lower - upper) * top_w
        weighted = weights[n] * value
        mean += weighted
        square += weighted * value
        product += weighted * values[n]
        d = weights[n] * slope
        q += d
        qb += d * value
        qa += d * values[n]
        dd = d * slope
        qq += dd
        d *= across[n]
        qu += d
        qub += d * value
        qua += d * values[n]
        dd *= across[n]
        qqu += dd
        qquu += dd * across[n]
        qquv += dd * down[n]
        d = weights[n] * slope * down[n]
        qv += d
        qvb += d * value
        qva += d * values[n]
        d *= slope
        qqv += d
        qqvv += d * down[n]
    variance = square - mean * mean
    if variance < _LEAST_VARIANCE or product <= zero:
        return
    contrast = product / variance
    qb -= q * mean
    qub -= qu * mean
    qvb -= qv * mean
    square = contrast * contrast
    matrix[0, 0] += square * (qq - q * q - qb * qb / variance)
    matrix[0, 1] += square * (qqu - q * qu - qb * qub / variance)
    matrix[0, 2] += square * (qqv - q * qv - qb * qvb / variance)
    matrix[1, 1] += square * (qquu - qu * qu - qub * qub / variance)
    matrix[1, 2] += square * (qquv - qu * qv - qub * qvb / variance)
    matrix[2, 2] += square * (qqvv - qv * qv - qvb * qvb / variance)
    right[0] += contrast * (qa - contrast * qb)
    right[1] += contrast * (qua - contrast * qub)
    right[2] += contrast * (qva - contrast * qvb)
