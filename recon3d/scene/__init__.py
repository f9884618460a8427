"""Calibrated photographs of one object."""

from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import (
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
    without_silhouettes,
)
from recon3d.scene.view import View

__all__ = [
    "Bounds",
    "Scene",
    "View",
    "with_mask_files",
    "with_segmented_silhouettes",
    "with_threshold_silhouettes",
    "without_silhouettes",
]
