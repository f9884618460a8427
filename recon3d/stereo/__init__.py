"""Dense matching inside the carved volume."""

from recon3d.stereo.fusion import Fusion, fuse
from recon3d.stereo.patch_match import DepthMap, Matching
from recon3d.stereo.refinement import PASSES, Refinement, refine

__all__ = [
    "PASSES",
    "DepthMap",
    "Fusion",
    "Matching",
    "Refinement",
    "fuse",
    "refine",
]
