"""Distances between the mean colours of the views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from recon3d.checks import require_choice, require_number
from recon3d.consistency.base import Patches, Verdict, verdict_of
from recon3d.consistency.moments import Moments
from recon3d.kernels.view_colors import largest_norms

_ORDERS = {"l1": 1, "l2": 2, "linf": 0}
_THRESHOLDS = {"l1": 240.0, "l2": 120.0, "linf": 90.0}


@dataclass(frozen=True)
class Minkowski:
    """The largest distance between two views' mean colours against one threshold.

    Consistent when max over j, k of |mu_j - mu_k| <= T in the norm L1, L2 or maximum. That all pairs must pass, as in
    one of the two papers, and that the largest must, as in the other, is the same.

    The degree is T / (T + distance), as in ``verdict_of``.

    References
    ----------
    Two sources, [34, 35] of Barhoumi et al., 2013; rebuilt from the summary there, section 2.
    """

    norm: Literal["l1", "l2", "linf"] = "l2"
    """Of the difference of two colours."""
    threshold: float | None = None
    """T in the norm's own units, colours 0 to 255; None: 240 for L1, 120 for L2, 90 for the maximum, chosen by
    ``scripts/tune_tests.py``. A third of those is best for the built-in temple alone, but leaves next to nothing of
    eight photographs of a real one."""

    def __post_init__(self) -> None:
        require_choice("norm", self.norm, _ORDERS)
        if self.threshold is not None:
            require_number("threshold", self.threshold, "[0, inf)")

    def __call__(self, patches: Patches) -> Verdict:
        """Largest distance of every voxel against T."""
        moments = Moments.of(patches)
        distance = np.empty(patches.n_voxels)
        largest_norms(moments.means, moments.seen, _ORDERS[self.norm], distance)
        return verdict_of(distance, _THRESHOLDS[self.norm] if self.threshold is None else self.threshold)
