"""Probabilities that voxels exist, from what the views show of them and from what may hide them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.rays import walk
from recon3d.kernels.types import Observed

_OPAQUE = 1e-4  # what is seen with less than this is not seen


class ColorModel(NamedTuple):
    """What colours views show where a voxel exists, and where it does not."""

    density: NDArray[np.float64]
    """(b, b, b) of independent colours, per cubed grey level."""
    sigma: float
    """Standard deviation of one surface's colour from view to view, grey levels."""
    outliers: float
    """Share of the views that show another colour although they see the voxel."""
    prior: float
    """Probability that a voxel exists."""


@kernel()
def visibility(
    probability: NDArray[np.float32], center: NDArray[np.float64], voxel: NDArray[np.int64], path: NDArray[np.int64]
) -> float:
    """Product of 1 - p over the voxels between a centre (in voxels) and a voxel (3,)."""
    through = 1.0
    flat = probability.reshape(-1)
    for n in range(walk(center, voxel, probability.shape, False, path) - 1):
        through *= 1.0 - flat[path[n]]
        if through < _OPAQUE:
            break
    return through


@kernel(parallel=True)
def exist(
    part: Part,
    observed: Observed,
    centers: NDArray[np.float64],
    probability: NDArray[np.float32],
    model: ColorModel,
    posterior: NDArray[np.float32],
    weights: NDArray[np.float32],
) -> None:
    """Posterior probability (n,) of every voxel, and its visibility in every view (n, n_views); centres in voxels."""
    voxels, colors, seen = observed
    density, sigma, outliers, prior = model
    n_views = centers.shape[0]
    independent = np.empty(n_views)
    weight = np.empty(n_views)
    path = np.empty(sum(probability.shape), np.int64)
    for n in span(part, voxels.shape[0]):
        for view in range(n_views):
            through = visibility(probability, centers[view], voxels[n], path) if seen[n, view] else 0.0
            weights[n, view] = through
            weight[view] = (1.0 - outliers) * through
            independent[view] = _density_at(density, colors[n, view])
        odds = likelihood_ratio(colors[n], weight, independent, sigma) * prior / (1.0 - prior)
        posterior[n] = odds / (1.0 + odds) if odds < 1e12 else 1.0


@kernel()
def likelihood_ratio(
    colors: NDArray[np.uint8], weight: NDArray[np.float64], independent: NDArray[np.float64], sigma: float
) -> float:
    """Likelihood of the views' colours (n_views, 3) where a surface exists, over that of independent colours.

    A sum over which view is the first to see the surface; after it the surface's colour is tracked as the mean of the
    colours so far, each counted by the probability that it shows the surface.
    """
    n_views = weight.shape[0]
    unseen = 1.0
    ratio = 0.0
    for first in range(n_views):
        if weight[first] > 0.0:
            ratio += unseen * weight[first] * _agreement(colors, weight, independent, sigma, first)
        unseen *= 1.0 - weight[first]
    return ratio + unseen


@kernel()
def _agreement(
    colors: NDArray[np.uint8], weight: NDArray[np.float64], independent: NDArray[np.float64], sigma: float, first: int
) -> float:
    """Likelihood ratio of the views after the first one that surely sees the surface."""
    red, green, blue = float(colors[first, 0]), float(colors[first, 1]), float(colors[first, 2])
    count = 1.0
    ratio = 1.0
    for view in range(first + 1, weight.shape[0]):
        if weight[view] <= 0.0:
            continue
        # What the colours so far predict: their mean, uncertain by 1 / count of one pixel's variance.
        variance = sigma * sigma * (1.0 + 1.0 / count)
        off_red, off_green, off_blue = colors[view, 0] - red, colors[view, 1] - green, colors[view, 2] - blue
        squared = off_red * off_red + off_green * off_green + off_blue * off_blue
        normal = np.exp(-0.5 * squared / variance) / (2.0 * np.pi * variance) ** 1.5
        shows = weight[view] * normal / independent[view]
        factor = 1.0 - weight[view] + shows
        ratio *= factor
        if shows > 0.0:
            share = shows / factor
            count += share
            red += share * off_red / count
            green += share * off_green / count
            blue += share * off_blue / count
    return ratio


@kernel()
def _density_at(density: NDArray[np.float64], color: NDArray[np.uint8]) -> Any:
    """Value of a colour histogram (b, b, b) at a colour."""
    bins = density.shape[0]
    return density[color[0] * bins // 256, color[1] * bins // 256, color[2] * bins // 256]


@kernel(parallel=True)
def blend(part: Part, colors: NDArray[np.uint8], weights: NDArray[np.float32], means: NDArray[np.uint8]) -> None:
    """Weighted mean (n, 3) of colours (n, n_views, 3); black where nothing has weight."""
    for n in span(part, colors.shape[0]):
        total = 0.0
        for view in range(colors.shape[1]):
            total += weights[n, view]
        for channel in range(3):
            value = 0.0
            for view in range(colors.shape[1]):
                value += weights[n, view] * colors[n, view, channel]
            means[n, channel] = int(value / total + 0.5) if total > 0.0 else 0
