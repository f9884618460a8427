"""Normalised cross-correlation of windows along the rays of pixels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.correlation import OUTSIDE, Plane, Samples, correlation, grid
from recon3d.kernels.types import Compared


class Window(NamedTuple):
    """What of the images is compared."""

    radius: int
    """Pixels from the middle to the sides."""
    spacing: int
    """Pixels between compared ones."""
    min_deviation: float
    """Grey levels; a window with less contrast has nothing to match."""


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

    Windows stand parallel to the image. The score of a depth is the mean of the two best correlations, or the only one
    where a single view holds the window; scores is -1 where there is none.
    """
    image, width, height = compared.image, compared.size[0], compared.size[1]
    nearest, farthest, step = tried
    n_others = compared.others.shape[0]
    half = window.radius // window.spacing
    reach = window.spacing * half
    count = (2 * half + 1) ** 2
    values, weights = np.empty(count, np.float32), np.full(count, 1 / count, np.float32)
    across, down = grid(half)
    for n in span(part, pixels.shape[0]):
        scores[n] = -1.0
        u = pixels[n, 0]
        v = pixels[n, 1]
        if u < reach or v < reach or u >= width - reach or v >= height - reach:
            continue
        mean = np.float32(0.0)
        for at in range(count):
            values[at] = image[v + window.spacing * int(down[at]), u + window.spacing * int(across[at])]
            mean += weights[at] * values[at]
        power = np.float32(0.0)
        for at in range(count):
            values[at] -= mean
            power += weights[at] * values[at] * values[at]
        if power < window.min_deviation * window.min_deviation:
            continue
        own = Samples(values, weights, across, down, mean, power, u, v, half, window.spacing)
        n_steps = int((farthest[n] - nearest[n]) / step) + 1
        previous = -1.0
        best_at = -1
        left = 0.0
        right = 0.0
        for s in range(n_steps):
            z = nearest[n] + s * step
            plane = Plane(1.0 / z, 0.0, 0.0)
            first = -1.0
            second = -1.0
            n_seen = 0
            for j in range(n_others if z > 0.0 else 0):  # nothing behind the camera is seen
                ncc = correlation(own, plane, compared, j)
                n_seen += ncc > OUTSIDE
                if ncc > first:
                    second = first
                    first = ncc
                elif ncc > second:
                    second = ncc
            score = 0.5 * (first + second) if n_seen > 1 else first
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
