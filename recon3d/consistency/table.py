"""Photo-consistency tests by name.

Where no paper gives a parameter's value, its default was chosen by ``scripts/tune_tests.py`` on the views of
Middlebury's templeRing that templeSparseRing does not hold, and on the built-in temple: never on photographs that
figures are reported on. Real photographs far apart ask for wide thresholds, the built-in ones for narrow ones.
"""

from collections.abc import Callable

from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.caching import ColorCaching
from recon3d.consistency.correlation import Correlation
from recon3d.consistency.deviation import Adaptive, StandardDeviation, Variance
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, FuzzySingle
from recon3d.consistency.histogram import Histogram
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
