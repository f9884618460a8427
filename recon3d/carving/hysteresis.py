"""The hysteresis: candidates stay that candidates connect to a consistent voxel (eq. 8)."""

from __future__ import annotations

from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from recon3d.checks import require_choice
from recon3d.consistency.base import Verdict
from recon3d.kernels.lattice import grow_consistent
from recon3d.volume.carved import Label

CANDIDATE = 255
"""Label of a voxel between both thresholds, only while the hysteresis is being resolved."""


Connectivity = Literal[6, 18, 26]


def neighbour_offsets(connectivity: Connectivity) -> NDArray[np.int64]:
    """(connectivity, 3) index steps to a voxel's neighbours."""
    require_choice("connectivity", connectivity, get_args(Connectivity))
    reach = {6: 1, 18: 2, 26: 3}[connectivity]
    return np.array([step for step in product((-1, 0, 1), repeat=3) if 0 < np.abs(step).sum() <= reach])


def label_voxels(labels: NDArray[np.uint8], voxels: NDArray[np.int64], verdict: Verdict) -> NDArray[np.int64]:
    """Label voxels (n, 3) of a volume (nx, ny, nz) by their verdict; returns the candidates (m, 3)."""
    kinds = [Label.CONSISTENT, CANDIDATE]
    labels[tuple(voxels.T)] = np.select([verdict.consistent, verdict.candidate], kinds, Label.INCONSISTENT)
    return voxels[verdict.candidate]


def keep_connected(labels: NDArray[np.uint8], candidates: NDArray[np.int64], offsets: NDArray[np.int64]) -> None:
    """Make candidates (m, 3) consistent that others connect to a consistent voxel, and the rest inconsistent.

    Parameters
    ----------
    labels : (nx, ny, nz) with no candidates but these.
    offsets : (k, 3) steps to the neighbours that connect.
    """
    grow_consistent(labels, candidates, offsets, CANDIDATE, int(Label.CONSISTENT))
    left = candidates[labels[tuple(candidates.T)] == CANDIDATE]
    labels[tuple(left.T)] = Label.INCONSISTENT
