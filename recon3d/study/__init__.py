"""Photo-consistency tests side by side."""

from recon3d.study.comparison import Comparison, compare
from recon3d.study.trials import Trial
from recon3d.study.variants import Variant, expand_variants

__all__ = [
    "Comparison",
    "Trial",
    "Variant",
    "compare",
    "expand_variants",
]
