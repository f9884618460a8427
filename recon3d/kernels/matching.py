"""Normalised cross-correlation of windows along the rays of pixels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.types import Compared


class Window(NamedTuple):
    """What of the images is compared."""

    radius: int
    """Pixels from the middle to the sides."""
    spacing: int
    """Pixels between compared ones."""
    min_deviation: float
    """Grey levels; a window with less contrast has nothing to match."""


class _Samples(NamedTuple):
    """A pixel's own window."""

    values: NDArray[np.float32]
    """(count,) grey levels less their mean, row by row."""
    mean: np.float32
    """Grey levels."""
    power: float
    """Sum of the squared values."""
    u: int
    """Column of the pixel."""
    v: int
    """Row of the pixel."""
    half: int
    """Samples from the middle to the sides."""
    spacing: int
    """Pixels between samples."""


class Tried(NamedTuple):
    """Depths that are tried for each pixel, world units along the optical axis."""

    nearest: NDArray[np.float64]
    """(n,) first one."""
    farthest: NDArray[np.float64]
    """(n,) last one, at most."""
    step: float
    """Between one and the next."""


@kernel(parallel=True)
def best_depths(
    part: Part,
    compared: Compared,
    window: Window,
    pixels: NDArray[np.int64],
    tried: Tried,
    depths: NDArray[np.float64],
    scores: NDArray[np.float64],
) -> None:
    """Depth at which the windows of a view's pixels (n, 2) agree best with other views, and that agreement.

    Windows stand parallel to the image. The score of a depth is the mean of the two best correlations; scores is -1
    where there is none.
    """
    image, width, height = compared.image, compared.size[0], compared.size[1]
    nearest, farthest, step = tried
    n_others = compared.others.shape[0]
    half = window.radius // window.spacing
    reach = window.spacing * half
    count = (2 * half + 1) ** 2
    values = np.empty(count, np.float32)
    for n in span(part, pixels.shape[0]):
        scores[n] = -1.0
        u = pixels[n, 0]
        v = pixels[n, 1]
        if u < reach or v < reach or u >= width - reach or v >= height - reach:
            continue
        mean = np.float32(0.0)
        at = 0
        for dv in range(-reach, reach + 1, window.spacing):
            for du in range(-reach, reach + 1, window.spacing):
                values[at] = image[v + dv, u + du]
                mean += values[at]
                at += 1
        mean /= np.float32(count)
        power = 0.0
        for at in range(count):
            values[at] -= mean
            power += values[at] * values[at]
        if power < count * window.min_deviation * window.min_deviation:
            continue
        own = _Samples(values, mean, power, u, v, half, window.spacing)
        n_steps = int((farthest[n] - nearest[n]) / step) + 1
        previous = -1.0
        best_at = -1
        left = 0.0
        right = 0.0
        for s in range(n_steps):
            z = nearest[n] + s * step
            first = -1.0
            second = -1.0
            for j in range(n_others):
                ncc = _correlation(own, z, compared, j)
                if ncc > first:
                    second = first
                    first = ncc
                elif ncc > second:
                    second = ncc
            score = 0.5 * (first + second) if n_others > 1 else first
            if best_at == s - 1 and best_at >= 0:
                right = score
            if score > scores[n]:
                scores[n] = score
                best_at = s
                left = previous
                right = -1.0
            previous = score
        if best_at >= 0:
            offset = 0.0
            curvature = left - 2 * scores[n] + right
            if left > -1.0 and right > -1.0 and curvature < -1e-9:
                offset = 0.5 * (left - right) / curvature
            depths[n] = nearest[n] + (best_at + offset) * step


@kernel()
def _correlation(own: _Samples, z: float, compared: Compared, j: int) -> float:
    """Correlation of a window at a depth with its image in another view; -1 where that leaves the image.

    Within a window the homography is as good as its affine part, which needs no division a sample. The mean, grey
    values near the other window's, keeps sums of squares small.
    """
    values, level, power, u, v, half, spacing = own
    H, e, other = compared.homographies[j], compared.epipoles[j], compared.others[j]
    width, height = compared.other_sizes[j, 0], compared.other_sizes[j, 1]
    w = z * (H[2, 0] * u + H[2, 1] * v + H[2, 2]) + e[2]
    if w <= 0.0:
        return -1.0
    x = (z * (H[0, 0] * u + H[0, 1] * v + H[0, 2]) + e[0]) / w
    y = (z * (H[1, 0] * u + H[1, 1] * v + H[1, 2]) + e[1]) / w
    scale = z * spacing / w
    xu = (H[0, 0] - x * H[2, 0]) * scale
    xv = (H[0, 1] - x * H[2, 1]) * scale
    yu = (H[1, 0] - y * H[2, 0]) * scale
    yv = (H[1, 1] - y * H[2, 1]) * scale
    wide = half * (abs(xu) + abs(xv)) + 1e-3
    high = half * (abs(yu) + abs(yv)) + 1e-3
    if not (x >= wide and y >= high and x + wide < width - 1.0 and y + high < height - 1.0):
        return -1.0
    total = np.float32(0.0)
    square = np.float32(0.0)
    product = np.float32(0.0)
    at = 0
    for dv in range(-half, half + 1):
        a = x + dv * xv - half * xu
        b = y + dv * yv - half * yu
        for _ in range(2 * half + 1):
            left = int(a)
            above = int(b)
            s = np.float32(a - left)
            t = np.float32(b - above)
            # Of a signed index numba asks whether it counts from the end.
            column, row = np.uint64(left), np.uint64(above)
            right, below = np.uint64(left + 1), np.uint64(above + 1)
            top = other[row, column] + s * (other[row, right] - other[row, column])
            bottom = other[below, column] + s * (other[below, right] - other[below, column])
            value = top + t * (bottom - top) - level
            total += value
            square += value * value
            product += value * values[at]
            at += 1
            a += xu
            b += yu
    variance = square - total * total / at
    if variance < np.float32(0.05) * at:  # rounding in single precision makes a flat window as uneven
        return -1.0
    return product / np.sqrt(power * variance)
