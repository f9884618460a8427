"""How photographs are calibrated."""

from __future__ import annotations

from dataclasses import dataclass

from recon3d.errors import ArgumentError


@dataclass(frozen=True)
class CalibrationSettings:
    """Options of ``calibrate``."""

    max_image_size: int = 2400
    """Features are found in photographs reduced to this many pixels on the longer side."""
    max_features: int = 8192
    """Features kept in a photograph, the coarsest first."""
    exhaustive_up_to: int = 150
    """Up to as many photographs each is matched with each; above, with its neighbours in the order of the names and
    with those that share some of its coarsest features."""
    min_registered: float = 0.5
    """Fraction of the photographs that must be placed; fewer end in an error."""
    principal_point_from: int = 30
    """Views of one camera from which on its principal point and a second coefficient of distortion are estimated."""
    seed: int = 0
    """Of all random sampling."""

    def __post_init__(self) -> None:
        if self.max_image_size < 64 or self.max_features < 64:
            raise ArgumentError(
                "expected max_image_size and max_features of at least 64, "
                f"got {self.max_image_size} and {self.max_features}"
            )
        if self.exhaustive_up_to < 2 or self.principal_point_from < 2:
            raise ArgumentError(
                "expected exhaustive_up_to and principal_point_from of at least 2, "
                f"got {self.exhaustive_up_to} and {self.principal_point_from}"
            )
        if not 0 < self.min_registered <= 1:
            raise ArgumentError(f"expected 0 < min_registered <= 1, got {self.min_registered}")
