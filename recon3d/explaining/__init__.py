"""Why a voxel was carved or kept."""

from recon3d.explaining.explanation import Explanation, explain

__all__ = [
    "Explanation",
    "explain",
]
