"""Sums, means and spreads of the colours of each view of each voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.consistency.base import Patches
from recon3d.kernels.view_colors import view_sums


@dataclass(frozen=True)
class Moments:
    """First two moments of P_j(v), whole numbers, so that the order of pixels cannot matter even by rounding."""

    counts: NDArray[np.int64]
    """(n_voxels, n_views) pixels; 0: the view does not see the voxel."""
    sums: NDArray[np.int64]
    """(n_voxels, n_views, 3) sum of the colours."""
    squares: NDArray[np.int64]
    """(n_voxels, n_views) sum of the squared colours, channels together."""

    @classmethod
    def of(cls, patches: Patches) -> Moments:
        """Moments of a batch."""
        counts = patches.counts
        sums, squares = np.empty((*counts.shape, 3), np.int64), np.empty(counts.shape, np.int64)
        view_sums(patches.colors, patches.view_starts, sums, squares)
        return cls(counts, sums, squares)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n_voxels, n_views)."""
        return np.asarray(self.counts > 0)

    @property
    def n_views(self) -> NDArray[np.int64]:
        """(n_voxels,) N."""
        return np.asarray(np.count_nonzero(self.counts, axis=1))

    @property
    def n_pixels(self) -> NDArray[np.int64]:
        """(n_voxels,) K."""
        return np.asarray(self.counts.sum(axis=1))

    @property
    def means(self) -> NDArray[np.float64]:
        """(n_voxels, n_views, 3) mu_j; 0 where the view does not see the voxel."""
        return np.asarray(self.sums / np.maximum(self.counts, 1)[..., None])

    @property
    def total_scatter(self) -> NDArray[np.float64]:
        """(n_voxels,) squared distances of all pixels from the mean of all, channels added: 3 K s^2."""
        sums, count = self.sums.sum(axis=1), self.n_pixels
        return np.asarray((count * self.squares.sum(axis=1) - (sums**2).sum(axis=-1)) / np.maximum(count, 1))

    @property
    def view_scatter(self) -> NDArray[np.float64]:
        """(n_voxels, n_views) the same within each view."""
        return np.asarray((self.counts * self.squares - (self.sums**2).sum(axis=-1)) / np.maximum(self.counts, 1))

    @property
    def deviation(self) -> NDArray[np.float64]:
        """(n_voxels,) s of all pixels together: root of the mean of the three channels' variances, grey levels."""
        return np.asarray(np.sqrt(self.total_scatter / np.maximum(3 * self.n_pixels, 1)))

    @property
    def view_deviations(self) -> NDArray[np.float64]:
        """(n_voxels, n_views) s_j; 0 where the view does not see the voxel."""
        return np.asarray(np.sqrt(self.view_scatter / np.maximum(3 * self.counts, 1)))

    def between_scatter(self, among: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """(n_voxels,) sum_j n_j |mu_j - mu|^2 over all views or some (n_voxels, n_views); mu is their mean."""
        counts = self.counts if among is None else np.where(among, self.counts, 0)
        sums = self.sums if among is None else np.where(among[..., None], self.sums, 0)
        mean = sums.sum(axis=1) / np.maximum(counts.sum(axis=1), 1)[:, None]
        return np.asarray((counts * ((self.means - mean[:, None]) ** 2).sum(axis=-1)).sum(axis=1))
