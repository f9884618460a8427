"""What the files of a scene say: what every reader returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.photograph import Photograph


class CalibratedImage(NamedTuple):
    """A photograph and its camera."""

    name: str
    """Of the view."""
    photograph: Photograph
    """Names the file, and whether it is to be read as it is stored; no pixels."""
    camera: Camera
    mask: Path | None = None
    """File of the object's mask, where the format names one."""


@dataclass(frozen=True)
class Calibrated:
    """Cameras and photographs, and what else a format knows; ``open_scene`` makes a scene of it."""

    name: str
    images: tuple[CalibratedImage, ...]
    bounds: Bounds | None = None
    """Box around the object, as it is used where the user gives none."""
    bounds_from: str = ""
    """Where the bounds come from, if they hold more than the object for certain."""
    no_bounds: str = ""
    """Why there are none, where the format has a place for them."""
    points: NDArray[np.float64] | None = field(default=None, repr=False, compare=False)
    """(n, 3) points of what the photographs show, world; a box is found from them where there are no bounds."""
    left_handed: bool = False
    """Whether the files' world, that of bounds, points and a README, is left-handed; the cameras are of its mirror."""
    mm_per_unit: float | None = None
    """Millimetres in a world unit, where the user does not say; None: the format has no unit."""
    masked: frozenset[str] | None = None
    """Names of the views whose silhouettes are good; None: all that have a mask."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """For tables and the run's record."""
