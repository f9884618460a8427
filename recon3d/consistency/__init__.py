"""Photo-consistency tests by name.

Where no paper gives a parameter's value, its default was chosen by ``scripts/tune_tests.py`` on the views of
Middlebury's templeRing that templeSparseRing does not hold, and on the built-in temple: never on photographs that
figures are reported on. Real photographs far apart ask for wide thresholds, the built-in ones for narrow ones.
"""

from collections.abc import Callable

from recon3d.consistency.base import ConsistencyTest, Patches, Verdict, verdict_of
from recon3d.consistency.caching import ColorCaching
from recon3d.consistency.correlation import Correlation
from recon3d.consistency.deviation import Adaptive, StandardDeviation, Variance
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, FuzzySingle, alternating_harmonic
from recon3d.consistency.histogram import Histogram
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.loading import load_by_path
from recon3d.consistency.minkowski import Minkowski
from recon3d.consistency.ratio import FTest, LikelihoodRatio, OutlierRejection
from recon3d.consistency.specular import Specular

TESTS: dict[str, Callable[..., ConsistencyTest]] = {
    "fuzzy": FuzzyAdaptiveHysteresis,
    "fuzzy-single": FuzzySingle,
    "variance": Variance,
    "standard-deviation": StandardDeviation,
    "adaptive": Adaptive,
    "histogram": Histogram,
    "color-caching": ColorCaching,
    "minkowski": Minkowski,
    "likelihood-ratio": LikelihoodRatio,
    "f-test": FTest,
    "outlier-rejection": OutlierRejection,
    "specular": Specular,
    "ncc": Correlation,
}


def load_test(name: str, /, **options: object) -> ConsistencyTest:
    """A photo-consistency test by name: one of ``TESTS``, or the user's own as "module:name".

    The module is imported from the current directory or wherever Python finds it. A class is called with the options;
    a function of the patches is the test itself, with the options as further keywords.

    Raises
    ------
    ValueError : no such test, module or name, not callable, or options it does not take; one line.
    """
    if ":" in name:
        return load_by_path(name, options)
    if name not in TESTS:
        raise ValueError(f"expected a test among {', '.join(TESTS)}, or module:name, got {name!r}")
    try:
        return TESTS[name](**options)
    except TypeError as error:
        raise ValueError(f"{name}: {error}") from None


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
