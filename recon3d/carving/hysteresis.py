"""Neighbourhoods through which candidates are connected."""

from __future__ import annotations

from itertools import product
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from recon3d.checks import require_choice

CANDIDATE = 255
"""Label of a voxel between both thresholds, only while the hysteresis is being resolved."""


Connectivity = Literal[6, 18, 26]


def neighbour_offsets(connectivity: Connectivity) -> NDArray[np.int64]:
    """(connectivity, 3) index steps to a voxel's neighbours."""
    require_choice("connectivity", connectivity, get_args(Connectivity))
    reach = {6: 1, 18: 2, 26: 3}[connectivity]
    return np.array([step for step in product((-1, 0, 1), repeat=3) if 0 < np.abs(step).sum() <= reach])
