"""Statistics of ragged pixel sets: voxel n owns the pixels starts[n] to starts[n + 1]."""

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span


@kernel(parallel=True)
def mean_colors(part: Part, colors: NDArray[np.uint8], starts: NDArray[np.int64], means: NDArray[np.uint8]) -> None:
    """Mean colour of every non-empty pixel set, rounded half up."""
    for n in span(part, means.shape[0]):
        count = starts[n + 1] - starts[n]
        for channel in range(3):
            total = 0
            for pixel in range(starts[n], starts[n + 1]):
                total += colors[pixel, channel]
            means[n, channel] = (2 * total + count) // (2 * count)


@kernel(parallel=True)
def decile_ratios(
    part: Part,
    colors: NDArray[np.uint8],
    starts: NDArray[np.int64],
    weights: NDArray[np.int64],
    trim: float,
    ratios: NDArray[np.float64],
) -> None:
    """Lowest over highest intensity between the trim and 1 - trim quantiles (nearest rank); 0 / 0 is 1.

    Intensity is the weighted channel sum over 1000, rounded; a result below what ratios already hold replaces it.
    """
    n_voxels = ratios.shape[0]
    histogram = np.zeros(256, np.int64)
    for n in span(part, n_voxels):
        count = starts[n + 1] - starts[n]
        for pixel in range(starts[n], starts[n + 1]):
            value = (
                weights[0] * colors[pixel, 0] + weights[1] * colors[pixel, 1] + weights[2] * colors[pixel, 2] + 500
            ) // 1000
            histogram[value] += 1
        # Ranks count from one; the subtraction keeps 0.1 * 10 from rounding up to rank 2.
        low_rank = max(int(np.ceil(trim * count - 1e-9)), 1)
        high_rank = max(int(np.ceil((1.0 - trim) * count - 1e-9)), 1)
        low = -1
        high = -1
        below = 0
        for value in range(256):
            below += histogram[value]
            histogram[value] = 0
            if low < 0 and below >= low_rank:
                low = value
            if high < 0 and below >= high_rank:
                high = value
        ratio = low / high if high > 0 else 1.0
        ratios[n] = min(ratios[n], ratio)
