"""What the files of a scene say: what every reader returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

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


@dataclass(frozen=True)
class Calibrated:
    """Cameras and photographs, and what else a format knows; ``open_scene`` makes a scene of it."""

    name: str
    images: tuple[CalibratedImage, ...]
    bounds: Bounds | None = None
    """Box around the object, as it is used where the user gives none."""
    no_bounds: str = "expected bounds, which the format does not hold"
    """Why there are no bounds: the error where the user gives none either."""
    mm_per_unit: float = 1000.0
    """Millimetres in a world unit, where the user does not say."""
    masks: Path | None = None
    """Folder of the scene's own masks."""
    masked: frozenset[str] | None = None
    """Names of the views whose silhouettes are good; None: all."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """For tables and the run's record."""
