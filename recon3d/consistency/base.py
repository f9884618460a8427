"""What a photo-consistency test is given, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Patches:
    """Pixels that a batch of voxels shows, voxel by voxel, view by view; no voxel is without pixels."""

    colors: NDArray[np.uint8]
    """(n_pixels, 3) RGB."""
    view_starts: NDArray[np.int64]
    """(n_voxels, n_views + 1): pixels of voxel n in view j are ``colors[view_starts[n, j]:view_starts[n, j + 1]]``.

    An empty range: the view does not see the voxel. A voxel's last entry is the next one's first.
    """

    @property
    def n_voxels(self) -> int:
        """Length of the batch."""
        return int(self.view_starts.shape[0])

    @property
    def starts(self) -> NDArray[np.int64]:
        """(n_voxels + 1,) where each voxel's pixels begin, all views together."""
        end = self.view_starts[-1:, -1] if self.n_voxels else np.zeros(1, np.int64)
        return np.concatenate([self.view_starts[:, 0], end])

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n_voxels, n_views) pixels of each voxel in each view."""
        return np.diff(self.view_starts, axis=1)

    @property
    def n_views(self) -> NDArray[np.int64]:
        """(n_voxels,) N(v), the number of views that see each voxel (eq. 6)."""
        return np.asarray(np.count_nonzero(self.counts, axis=1))

    @property
    def voxel_of_pixel(self) -> NDArray[np.int64]:
        """(n_pixels,) voxel that each pixel belongs to, for ``np.bincount`` and the like."""
        return np.repeat(np.arange(self.n_voxels), np.diff(self.starts))


@dataclass(frozen=True)
class Verdict:
    """Degree of photo-consistency and the two thresholds of the hysteresis, voxel by voxel.

    Consistent at ``degree >= high``; else carved at ``degree <= low``; a candidate between, which stays when
    candidates connect it to a consistent voxel. A test with one threshold has ``low == high``.
    """

    degree: NDArray[np.float64]
    """(n_voxels,) in [0, 1]."""
    low: NDArray[np.float64]
    """(n_voxels,)."""
    high: NDArray[np.float64]
    """(n_voxels,)."""

    def __post_init__(self) -> None:
        if not self.degree.shape == self.low.shape == self.high.shape or self.degree.ndim != 1:
            raise ValueError(
                f"expected degree, low and high of one length, got {self.degree.shape}, {self.low.shape}, "
                f"{self.high.shape}"
            )
        if not ((self.degree >= 0) & (self.degree <= 1)).all():
            raise ValueError("expected every degree in [0, 1]; a test gave NaN or a number outside")
        if not (self.low <= self.high).all():
            raise ValueError("expected low <= high for every voxel")


@runtime_checkable
class ConsistencyTest(Protocol):
    """Anything that judges a batch of voxels; plain numpy will do."""

    def __call__(self, patches: Patches) -> Verdict:
        """Judge every voxel of the batch from its pixels alone; the batch may be empty."""
