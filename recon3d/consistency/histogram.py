"""Views agree when their colour histograms intersect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.checks import require_number, require_whole
from recon3d.consistency.base import Patches, Verdict
from recon3d.kernels.view_colors import shared_bins

_MOST_BINS = 32  # a channel; their cube is kept as bits for every view


@dataclass(frozen=True)
class Histogram:
    """Every two views share a filled bin of their RGB histograms.

    Each channel is divided into equal bins that overlap, so that a colour near a border lies in the bins on both
    sides of it, and noise does not part two views. A bin is filled by one pixel. No threshold on colours is needed; the
    bins' width takes its place.

    The degree is the share of the pairs of views that intersect, and all of them must: the threshold is 1. Give
    it a margin with ``Hysteresis`` to allow for noise.

    References
    ----------
    M. R. Stevens, B. Culbertson, T. Malzbender, "A histogram-based color consistency test for voxel coloring",
    ICPR 2002. Rebuilt from the summary in Barhoumi et al., 2013, section 2.
    """

    bins: int = 8
    """Bins of a channel, 1 to 32."""
    overlap: float = 0.2
    """Width that two neighbouring bins share, as a fraction of a bin without overlap; in [0, 1)."""

    def __post_init__(self) -> None:
        require_whole("bins", self.bins, most=_MOST_BINS)
        require_number("overlap", self.overlap, "[0, 1)")

    def __call__(self, patches: Patches) -> Verdict:
        """Share of intersecting pairs of views."""
        place = np.arange(256) * self.bins / 256  # in bins
        first, last = (
            np.clip(np.floor(place + side * self.overlap / 2), 0, self.bins - 1).astype(np.int64) for side in (-1, 1)
        )
        degree, ones = np.empty(patches.n_voxels), np.ones(patches.n_voxels)
        shared_bins(patches.colors, patches.view_starts, int(self.bins), first, last, degree)
        return Verdict(degree, ones, ones)
