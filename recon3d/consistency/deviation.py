"""Tests on the spread of all pixels of a voxel together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.consistency.base import Patches, Verdict

_LARGEST_DEVIATION = 127.5  # of numbers in 0..255


@dataclass(frozen=True)
class StandardDeviation:
    """Root mean square of the three channels' standard deviations against one threshold.

    Consistent when s = sqrt((s_R^2 + s_G^2 + s_B^2) / 3) <= T; the degree is 1 - s / 127.5. It is the plain test that
    Barhoumi et al. compare with (their section 4), after Seitz and Dyer, "Photorealistic scene reconstruction by
    voxel coloring", 1999.
    """

    threshold: float = 30.0
    """T, in grey levels of 0 to 255."""

    def __post_init__(self) -> None:
        if not 0 <= self.threshold <= _LARGEST_DEVIATION:
            raise ValueError(f"expected a threshold between 0 and {_LARGEST_DEVIATION}, got {self.threshold}")

    def __call__(self, patches: Patches) -> Verdict:
        """Degree of every voxel against the one threshold."""
        owner = patches.voxel_of_pixel
        count = np.diff(patches.starts)
        variance = np.zeros(patches.n_voxels)
        for channel in patches.colors.T.astype(np.float64):
            mean = np.bincount(owner, channel, patches.n_voxels) / count
            variance += np.bincount(owner, (channel - mean[owner]) ** 2, patches.n_voxels) / count / 3
        degree = 1 - np.sqrt(variance) / _LARGEST_DEVIATION
        limit = np.full(patches.n_voxels, 1 - self.threshold / _LARGEST_DEVIATION)
        return Verdict(np.clip(degree, 0, 1), limit, limit)
