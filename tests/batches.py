"""Ragged batches of voxels for photo-consistency tests, and the three outcomes."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.consistency.base import Patches, Verdict

WINDOW_SIDE = 5


def patches_of(voxels: list[list[ArrayLike]]) -> Patches:
    """Patches from colours (n, 3) voxel by voxel, view by view.

    Direction and window of a view are random, but decided by the colours it shows in whatever order.
    """
    colors, view_starts, directions, windows, at = [], [], [], [], 0
    for views in voxels:
        row = [at]
        for pixels in views:
            block = np.asarray(pixels, np.uint8).reshape(-1, 3)
            colors.append(block)
            at += len(block)
            row.append(at)
            directions.append(direction_of(block))
            windows.append(window_of(block))
        view_starts.append(row)
    starts = np.array(view_starts, np.int64)
    shape = (len(voxels), starts.shape[1] - 1, -1)
    return Patches(
        np.vstack(colors),
        starts,
        np.array(directions, np.float32).reshape(shape),
        np.array(windows, np.float32).reshape(shape),
    )


def direction_of(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(3,) unit vector."""
    direction = _rng_of(pixels).standard_normal(3)
    return direction / np.linalg.norm(direction)


def window_of(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(side * side,) their luminances, scattered; NaN without pixels."""
    if not len(pixels):
        return np.full(WINDOW_SIDE**2, np.nan)
    luminance = np.sort(pixels @ np.array([0.299, 0.587, 0.114]))
    return _rng_of(pixels).permutation(np.resize(luminance, WINDOW_SIDE**2))


def _rng_of(pixels: NDArray[np.uint8]) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(pixels[np.lexsort(pixels.T)].tobytes()))


def random_voxel(rng: np.random.Generator, n_views: int, spread: float) -> list[ArrayLike]:
    base = rng.integers(40, 200, 3)
    return [
        np.clip(base + spread * rng.standard_normal((rng.integers(1, 12), 3)), 0, 255).astype(np.uint8)
        for _ in range(n_views)
    ]


def random_batch(seed: int = 0) -> list[list[ArrayLike]]:
    rng = np.random.default_rng(seed)
    return [random_voxel(rng, 4, spread) for spread in (0, 3, 10, 25, 40, 80) for _ in range(6)]


def outcome(verdict: Verdict) -> np.ndarray:
    """1 consistent, 0 candidate, -1 carved."""
    return np.where(verdict.degree >= verdict.high, 1, np.where(verdict.degree <= verdict.low, -1, 0))
