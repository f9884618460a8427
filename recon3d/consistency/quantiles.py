"""Limits of statistical tests, voxel by voxel."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


def chi_square_limits(p: float, degrees: NDArray[np.int64]) -> NDArray[np.float64]:
    """What a chi-square variable with the given degrees of freedom (n,) exceeds with probability p; 0 for 0 degrees."""
    known, where = np.unique(degrees, return_inverse=True)
    return np.array([_chi_square(p, int(d)) for d in known], np.float64)[where]


def f_limits(p: float, between: NDArray[np.int64], within: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n,) what an F variable exceeds with probability p, from its degrees of freedom (n,) between and within.

    0 for 0 degrees between; 0 within stands for infinitely many.
    """
    pairs = between * (1 << 32) + within
    known, where = np.unique(pairs, return_inverse=True)
    return np.array([_f(p, *divmod(int(pair), 1 << 32)) for pair in known], np.float64)[where]


@lru_cache(maxsize=1 << 16)
def _chi_square(p: float, degrees: int) -> float:
    from scipy.stats import chi2  # half a second to import, and few tests need it

    return float(chi2.isf(p, degrees)) if degrees else 0.0


@lru_cache(maxsize=1 << 16)
def _f(p: float, between: int, within: int) -> float:
    from scipy.stats import f

    if not between:
        return 0.0
    # A variance that is known, not estimated: F becomes chi-square over its degrees of freedom.
    return float(f.isf(p, between, within)) if within else _chi_square(p, between) / between
