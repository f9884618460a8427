"""Photo-consistency tests: what they are given and answer, those of the papers, and the user's own by name."""

from recon3d.consistency.base import ConsistencyTest, Patches, Verdict, verdict_of
from recon3d.consistency.caching import ColorCaching
from recon3d.consistency.correlation import Correlation
from recon3d.consistency.deviation import Adaptive, StandardDeviation, Variance
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, FuzzySingle, alternating_harmonic
from recon3d.consistency.histogram import Histogram
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.minkowski import Minkowski
from recon3d.consistency.ratio import FTest, LikelihoodRatio, OutlierRejection
from recon3d.consistency.spec import load_test
from recon3d.consistency.specular import Specular
from recon3d.consistency.table import TESTS

__all__ = [
    "TESTS",
    "Adaptive",
    "ColorCaching",
    "ConsistencyTest",
    "Correlation",
    "FTest",
    "FuzzyAdaptiveHysteresis",
    "FuzzySingle",
    "Histogram",
    "Hysteresis",
    "LikelihoodRatio",
    "Minkowski",
    "OutlierRejection",
    "Patches",
    "Specular",
    "StandardDeviation",
    "Variance",
    "Verdict",
    "alternating_harmonic",
    "load_test",
    "verdict_of",
]
