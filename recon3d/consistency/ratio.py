"""Tests on the variance between the views' mean colours, by chi-square and F quantiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.checks import require_number
from recon3d.consistency.base import Patches, Verdict, verdict_of
from recon3d.consistency.moments import Moments
from recon3d.consistency.quantiles import chi_square_limits, f_limits

_NORMAL_MAD = 1.4826  # standard deviations of a normal variable in its median absolute deviation
_OUTLIER = 2.5  # standard deviations


@dataclass(frozen=True)
class LikelihoodRatio:
    """Likelihood that all views show one colour, against that each shows its own, with noise of a known deviation.

    Consistent when sum_j n_j |mu_j - mu|^2 <= sigma0^2 q, with n_j pixels of mean mu_j in view j, mu the mean of all
    pixels, and q the chi-square variable's 1 - p quantile with 3 (N - 1) degrees of freedom. One view always is.

    Pixels of a textured voxel are no independent samples, so sigma0 has to be larger than the sensor's noise, the more
    so the more pixels a voxel covers. The degree is limit / (limit + value), as in ``verdict_of``.

    References
    ----------
    W. B. Culbertson, T. Malzbender, G. Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999. Rebuilt from
    the summary in Barhoumi et al., 2013, section 2.
    """

    sigma0: float = 60.0
    """Deviation of a pixel's channel from the colour of the voxel, grey levels; texture included. Chosen by
    ``scripts/tune_tests.py``."""
    p: float = 0.05
    """Share of true surface that may be refused."""

    def __post_init__(self) -> None:
        require_number("sigma0", self.sigma0, "(0, inf)")
        require_number("p", self.p, "(0, 1)")

    def __call__(self, patches: Patches) -> Verdict:
        """Statistic of every voxel against the chi-square limit."""
        moments = Moments.of(patches)
        limit = self.sigma0**2 * chi_square_limits(self.p, 3 * np.maximum(moments.n_views - 1, 0))
        return verdict_of(moments.between_scatter(), limit)


@dataclass(frozen=True)
class FTest:
    """Variance between the views over the variance within them: no noise need be known.

    Consistent when F = [sum_j n_j |mu_j - mu|^2 / 3 (N - 1)] / w^2 is at most the F variable's 1 - p quantile with
    3 (N - 1) and 3 (K - N) degrees of freedom, w^2 = sum_j sum (c - mu_j)^2 / 3 (K - N) over K pixels.

    w is taken to be at least ``floor``: rounding to whole grey levels would otherwise part views of one flat colour.
    With one pixel a view nothing is known of w; the floor stands for it as if it were known, with the chi-square
    quantile that F then becomes. The degree is limit / (limit + F), as in ``verdict_of``.

    References
    ----------
    A. Broadhurst, R. Cipolla, "A statistical consistency check for the space carving algorithm", BMVC 2000. Rebuilt
    from the summary in Barhoumi et al., 2013, section 2; the floor is ours.
    """

    p: float = 0.05
    """Share of true surface that may be refused."""
    floor: float = 60.0
    """Smallest deviation within a view that is believed, grey levels. Chosen by ``scripts/tune_tests.py``: views far
    apart differ by more than noise, the plain F test (floor 1) leaves next to nothing, and the default often decides
    alone."""

    def __post_init__(self) -> None:
        require_number("p", self.p, "(0, 1)")
        require_number("floor", self.floor, "(0, inf)")

    def __call__(self, patches: Patches) -> Verdict:
        """F of every voxel against its quantile."""
        moments = Moments.of(patches)
        between = 3 * np.maximum(moments.n_views - 1, 0)
        within = 3 * (moments.n_pixels - moments.n_views)
        variance = np.maximum(moments.view_scatter.sum(axis=1) / np.maximum(within, 1), self.floor**2)
        value = moments.between_scatter() / np.maximum(between, 1) / variance
        return verdict_of(value, f_limits(self.p, between, within))


@dataclass(frozen=True)
class OutlierRejection:
    """The likelihood ratio of the views that are left when outliers are dropped, if enough of them are.

    A view is an outlier when |mu_j - m| > 2.5 * 1.4826 * MAD, m the median of the means channel by channel and MAD
    the median of all |mu_j - m|; but never below 2.5 sigma0 / sqrt(n_j), which noise explains. Consistent when
    more than ``quorum`` of the views are left and pass ``LikelihoodRatio``. So one bad view of three or more is
    forgiven, by design: it may have been occluded.

    The degree is limit / (limit + value) of the ratio, and 0 without a quorum.

    References
    ----------
    V. Zyka, R. Sara, "Polynocular image set consistency for local model verification", 2000. Rebuilt from the summary
    in Barhoumi et al., 2013, section 2.
    """

    sigma0: float = 25.0
    """Deviation of a pixel's channel from the colour of the voxel, grey levels; texture included. Chosen by
    ``scripts/tune_tests.py``; below the default of ``LikelihoodRatio``, since here the worst views do not count."""
    p: float = 0.05
    """Share of true surface that the ratio may refuse."""
    quorum: float = 0.5
    """Fraction of the seeing views, of which more have to be left."""

    def __post_init__(self) -> None:
        require_number("sigma0", self.sigma0, "(0, inf)")
        require_number("p", self.p, "(0, 1)")
        require_number("quorum", self.quorum, "[0, 1)")

    def __call__(self, patches: Patches) -> Verdict:
        """Statistic of the inliers of every voxel against their chi-square limit."""
        moments = Moments.of(patches)
        inliers = self.inliers(moments)
        n_inliers = np.count_nonzero(inliers, axis=1)
        limit = self.sigma0**2 * chi_square_limits(self.p, 3 * np.maximum(n_inliers - 1, 0))
        enough = n_inliers > self.quorum * moments.n_views
        return verdict_of(np.where(enough, moments.between_scatter(inliers), np.inf), limit)

    def inliers(self, moments: Moments) -> NDArray[np.bool_]:
        """(n_voxels, n_views) the views that see the voxel and are no outliers."""
        seen, means = moments.seen, moments.means
        middle = np.stack([_median(means[..., channel], seen) for channel in range(3)], axis=-1)
        away = np.sqrt(((means - middle[:, None]) ** 2).sum(axis=-1))
        spread = _NORMAL_MAD * _median(away, seen)
        noise = self.sigma0 / np.sqrt(np.maximum(moments.counts, 1))
        return np.asarray(seen & (away <= _OUTLIER * np.maximum(spread[:, None], noise)))


def _median(values: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(n,) medians of the seen values (n, n_views); 0 where none is."""
    ascending = np.sort(np.where(seen, values, np.inf), axis=1)
    count = np.count_nonzero(seen, axis=1)[:, None]
    middle = [np.take_along_axis(ascending, np.maximum(count - back, 0) // 2, axis=1) for back in (1, 0)]
    return np.where(count > 0, (middle[0] + middle[1]) / 2, 0)[:, 0]
