"""Two thresholds for any test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.checks import require_number
from recon3d.consistency.base import AroundTest, ConsistencyTest, Patches, Verdict, require_test


@dataclass(frozen=True)
class Hysteresis(AroundTest):
    """Any photo-consistency test with a band of candidates around its threshold.

    The test's degree stays as it is. A voxel is a candidate where its degree lies within ``margin`` of the threshold,
    for a test with two thresholds of the middle between them; the engines keep it when candidates connect it to
    a consistent voxel. Thresholds do not leave [0, 1], so that perfect agreement is always consistent.

    Hysteresis for any test is ours, after Barhoumi, Bakkay, Zargouba, "Automated photo-consistency test for voxel
    colouring based on fuzzy adaptive hysteresis thresholding", 2013, equation 8.
    """

    test: ConsistencyTest
    """Gives the degree."""
    margin: float | None = 0.05
    """Half the width of the band, in degrees of the test; None: the test's own two thresholds."""

    def __post_init__(self) -> None:
        require_test(self.test)
        if self.margin is not None:
            require_number("margin", self.margin, "[0, 1]")

    def __call__(self, patches: Patches) -> Verdict:
        """The test's verdict with wider or narrower thresholds."""
        verdict = self.test(patches)
        if self.margin is None:
            return verdict
        middle = (verdict.low + verdict.high) / 2
        low, high = np.clip(middle - self.margin, 0, 1), np.clip(middle + self.margin, 0, 1)
        return Verdict(verdict.degree, low, high)
