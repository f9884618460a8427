"""Engines ask a photo-consistency test through here: it gets what it needs, and its answer is checked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.views import ViewArrays
from recon3d.consistency import ConsistencyTest, Patches, Verdict
from recon3d.kernels.windows import sample_windows

_NUMBERS = 1 << 24  # of directions and windows at once: 64 MiB


def judge(
    test: ConsistencyTest, patches: Patches, centers: NDArray[np.float64], voxel_size: float, views: ViewArrays
) -> Verdict:
    """Verdict of a test on the voxels around centres (n, 3), with the directions and windows that the test asks for.

    Such extras take more memory than pixels do, so a test that wants them gets a large batch in parts.
    """
    directed, side = bool(getattr(test, "needs_directions", False)), int(getattr(test, "window_side", 0))
    numbers = len(views.centers) * (3 * directed + side * side)
    if not numbers:
        return _checked(test, patches)
    step = max(_NUMBERS // numbers, 1)
    verdicts = []
    for start in range(0, max(len(centers), 1), step):
        points = centers[start : start + step]
        part = patches.part(start, start + len(points))
        directions = _directions(points, views) if directed else None
        windows = _windows(points, part.counts, side, views, voxel_size) if side else None
        verdicts.append(_checked(test, Patches(part.colors, part.view_starts, directions, windows)))
    return Verdict(*(np.concatenate([getattr(v, name) for v in verdicts]) for name in ("degree", "low", "high")))


def _checked(test: ConsistencyTest, patches: Patches) -> Verdict:
    """The test's verdict, if it is one, of the batch's length."""
    verdict = test(patches)
    if not isinstance(verdict, Verdict):
        raise ValueError(f"{test!r}: expected a Verdict, got {type(verdict).__name__}")
    if len(verdict.degree) != patches.n_voxels:
        raise ValueError(f"{test!r} judged {len(verdict.degree)} voxels of {patches.n_voxels}")
    return verdict


def _directions(centers: NDArray[np.float64], views: ViewArrays) -> NDArray[np.float32]:
    """(n, n_views, 3) unit vectors from points (n, 3) to the cameras."""
    toward = views.centers - centers[:, None]
    length = np.linalg.norm(toward, axis=-1, keepdims=True)
    return np.asarray(toward / np.maximum(length, np.finfo(np.float64).tiny), np.float32)


def _windows(
    centers: NDArray[np.float64], counts: NDArray[np.int64], side: int, views: ViewArrays, voxel_size: float
) -> NDArray[np.float32]:
    """(n, n_views, side * side) luminance of the views around points (n, 3); NaN where no pixel sees the voxel.

    Samples lie one pixel apart, as fine as the views are, but farther where the voxel is larger than the window: the
    surface may pass anywhere in it, and views must agree on what the whole voxel shows.
    """
    windows = np.empty((*counts.shape, side * side), np.float32)
    sample_windows(
        centers, voxel_size, counts, views.centers, views.projections, views.focals, views.sizes, views.images, side,
        windows,
    )  # fmt: skip
    return windows
