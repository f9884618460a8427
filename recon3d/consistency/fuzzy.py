"""The paper's own test: fuzzy membership against two adaptive thresholds, or against one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import accumulate
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.checks import require_choice, require_number
from recon3d.consistency.base import Patches, Verdict
from recon3d.errors import ArgumentError
from recon3d.kernels.ragged import decile_ratios

LUMINANCE = np.array([299, 587, 114])
"""Weights of red, green and blue in thousandths, ITU-R BT.601; the sum is rounded half up."""

Intensity = Literal["luminance", "channels"]

_CHANNELS = 1000 * np.eye(3, dtype=np.int64)


def alternating_harmonic(n: ArrayLike) -> NDArray[np.float64]:
    """S(n) = 1 - 1/2 + 1/3 - ... +- 1/n (eq. 9), limit log 2; of whole numbers >= 1, any shape."""
    order = np.asarray(n, np.int64)
    if order.size and order.min() < 1:
        raise ArgumentError(f"expected n >= 1, got {order.min()}")
    # Exact until the end: a degree such as 70 / 120 must meet its threshold S(4) = 7 / 12.
    terms = (Fraction((-1) ** (k - 1), k) for k in range(1, int(order.max(initial=1)) + 1))
    return np.array([float(partial) for partial in accumulate(terms)])[order - 1]


@dataclass(frozen=True)
class _Membership:
    """Parameters of the fuzzy membership (eq. 7), and the membership itself."""

    intensity: Intensity = "luminance"
    """8-bit luminance, or the smallest of the three channels' ratios: the paper says "colour" and "intensities"."""
    trim: float = 0.1
    """Fraction of the pixels left out at either end as outliers."""

    def __post_init__(self) -> None:
        require_choice("intensity", self.intensity, get_args(Intensity))
        require_number("trim", self.trim, "[0, 0.5)")

    def membership(self, patches: Patches) -> NDArray[np.float64]:
        """mu(v) (n_voxels,) in [0, 1] (eq. 7)."""
        degree = np.ones(patches.n_voxels)
        for weights in LUMINANCE[None] if self.intensity == "luminance" else _CHANNELS:
            decile_ratios(patches.colors, patches.starts, weights, self.trim, degree)
        return degree


@dataclass(frozen=True)
class FuzzyAdaptiveHysteresis(_Membership):
    """Fuzzy membership with adaptive hysteresis thresholds.

    mu(v) is the lowest over the highest intensity of the voxel's pixels, all views together, between their first
    and ninth decile (eq. 7); T_low = S(2N), T_high = S(2N + 1) for N views, S the alternating harmonic series
    (eq. 9), so that more views are judged more strictly.

    Deciles are nearest ranks, so sets of one or two pixels keep all of them; 0 / 0 is 1, a black patch is
    homogeneous.

    References
    ----------
    W. Barhoumi, M. C. Bakkay, E. Zargouba, "Automated photo-consistency test for voxel colouring based on fuzzy
    adaptive hysteresis thresholding", IET Image Processing 7(8), 2013, eq. 7-9.
    """

    def __call__(self, patches: Patches) -> Verdict:
        """Membership mu and the two thresholds of every voxel."""
        n_views = patches.n_views
        return Verdict(
            self.membership(patches), alternating_harmonic(2 * n_views), alternating_harmonic(2 * n_views + 1)
        )


@dataclass(frozen=True)
class FuzzySingle(_Membership):
    """The fuzzy membership mu(v) against one threshold: consistent at mu >= T.

    What the paper's Fig. 3 shows, to argue for the hysteresis: its best results are "around log(2)", where its two
    adaptive thresholds meet for many views.

    References
    ----------
    W. Barhoumi, M. C. Bakkay, E. Zargouba, "Automated photo-consistency test for voxel colouring based on fuzzy
    adaptive hysteresis thresholding", IET Image Processing 7(8), 2013, eq. 7, section 3.3, Fig. 3.
    """

    threshold: float = math.log(2)
    """T, in [0, 1]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_number("threshold", self.threshold, "[0, 1]")

    def __call__(self, patches: Patches) -> Verdict:
        """Membership mu of every voxel against T."""
        limit = np.full(patches.n_voxels, float(self.threshold))
        return Verdict(self.membership(patches), limit, limit)
