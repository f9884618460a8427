"""Photo-consistency tests side by side."""

from recon3d.study.comparison import Comparison, compare
from recon3d.study.trials import Trial
from recon3d.study.variants import Contestant, contestants

__all__ = [
    "Comparison",
    "Contestant",
    "Trial",
    "compare",
    "contestants",
]
