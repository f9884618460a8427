"""Photo-consistency tests by name."""

from collections.abc import Callable

from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, alternating_harmonic

TESTS: dict[str, Callable[..., ConsistencyTest]] = {
    "fuzzy": FuzzyAdaptiveHysteresis,
    "standard-deviation": StandardDeviation,
}

__all__ = [
    "TESTS",
    "ConsistencyTest",
    "FuzzyAdaptiveHysteresis",
    "Patches",
    "StandardDeviation",
    "Verdict",
    "alternating_harmonic",
]
