"""Calibrated photographs of one object."""

from recon3d.scene.bounds import bounds_corners, make_bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import (
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
    without_silhouettes,
)
from recon3d.scene.view import View

__all__ = [
    "Scene",
    "View",
    "bounds_corners",
    "make_bounds",
    "with_mask_files",
    "with_segmented_silhouettes",
    "with_threshold_silhouettes",
    "without_silhouettes",
]
