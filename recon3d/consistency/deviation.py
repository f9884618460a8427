"""Tests on the spread of all pixels of a voxel together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon3d.checks import require_number
from recon3d.consistency.base import Patches, Verdict, verdict_of
from recon3d.consistency.moments import Moments
from recon3d.consistency.quantiles import chi_square_limits

_LARGEST_DEVIATION = 127.5  # of numbers in 0..255


@dataclass(frozen=True)
class StandardDeviation:
    """Root mean square of the three channels' standard deviations against one threshold.

    Consistent when s = sqrt((s_R^2 + s_G^2 + s_B^2) / 3) <= T; the degree is 1 - s / 127.5. It is the plain test that
    Barhoumi et al. compare with (their section 4), after Seitz and Dyer, "Photorealistic scene reconstruction by
    voxel coloring", 1999.
    """

    threshold: float = 30.0
    """T, in grey levels of 0 to 255. Chosen by ``scripts/tune_tests.py``."""

    def __post_init__(self) -> None:
        require_number("threshold", self.threshold, f"[0, {_LARGEST_DEVIATION}]")

    def __call__(self, patches: Patches) -> Verdict:
        """Degree of every voxel against the one threshold."""
        degree = 1 - Moments.of(patches).deviation / _LARGEST_DEVIATION
        limit = np.full(patches.n_voxels, 1 - self.threshold / _LARGEST_DEVIATION)
        return Verdict(np.clip(degree, 0, 1), limit, limit)


@dataclass(frozen=True)
class Variance:
    """The pixels' variance against what noise of a known deviation explains.

    Consistent when sum over K pixels and 3 channels of (c - mean)^2 <= sigma0^2 q, q the chi-square variable's
    1 - p quantile with 3 (K - 1) degrees of freedom: Seitz and Dyer's (K - 1) s^2 / sigma0^2, all channels together.
    With independent Gaussian noise a share p of true surface is refused, whatever K. Pixels of a textured voxel are
    not independent samples of one colour, so that sigma0 is in practice a threshold on s.

    The degree is limit / (limit + value), as in ``verdict_of``.

    References
    ----------
    S. M. Seitz, C. R. Dyer, "Photorealistic scene reconstruction by voxel coloring", IJCV 35(2), 1999. Rebuilt from
    the summary in Barhoumi et al., 2013, section 2.
    """

    sigma0: float = 30.0
    """Deviation of a channel that the pixels of one surface voxel may have, grey levels; texture included. Chosen by
    ``scripts/tune_tests.py``."""
    p: float = 0.05
    """Share of true surface that may be refused."""

    def __post_init__(self) -> None:
        require_number("sigma0", self.sigma0, "(0, inf)")
        require_number("p", self.p, "(0, 1)")

    def __call__(self, patches: Patches) -> Verdict:
        """Scatter of every voxel against the chi-square limit."""
        moments = Moments.of(patches)
        limit = self.sigma0**2 * chi_square_limits(self.p, 3 * np.maximum(moments.n_pixels - 1, 0))
        return verdict_of(moments.total_scatter, limit)


@dataclass(frozen=True)
class Adaptive:
    """The pixels' deviation against a threshold that grows with the texture inside the views.

    Consistent when s <= T1 + T2 mean_j(s_j), s the deviation of all pixels together and s_j that of the pixels of
    view j alone, as in ``StandardDeviation``: an edge or texture is no disagreement between the views.

    The degree is limit / (limit + s), as in ``verdict_of``.

    References
    ----------
    G. G. Slabaugh, W. B. Culbertson, T. Malzbender, M. R. Stevens, R. W. Schafer, "Methods for volumetric
    reconstruction of visual scenes", IJCV 57(3), 2004. Rebuilt from the summary in Barhoumi et al., 2013, section 2.
    """

    base: float = 10.0
    """T1, grey levels."""
    texture: float = 1.0
    """T2, of the mean deviation inside the views."""

    def __post_init__(self) -> None:
        require_number("base", self.base, "[0, inf)")
        require_number("texture", self.texture, "[0, inf)")

    def __call__(self, patches: Patches) -> Verdict:
        """Deviation of every voxel against its own limit."""
        moments = Moments.of(patches)
        inside = moments.view_deviations.sum(axis=1) / np.maximum(moments.n_views, 1)
        return verdict_of(moments.deviation, self.base + self.texture * inside)
