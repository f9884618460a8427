"""Calibrated photographs of one object."""

from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.mask import Mask
from recon3d.scene.photograph import Photograph
from recon3d.scene.pixel_cache import PIXELS
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import (
    with_mask_files,
    with_threshold_silhouettes,
    without_silhouettes,
)
from recon3d.scene.view import View

__all__ = [
    "PIXELS",
    "Bounds",
    "Camera",
    "Mask",
    "Photograph",
    "Scene",
    "View",
    "with_mask_files",
    "with_segmented_silhouettes",
    "with_threshold_silhouettes",
    "without_silhouettes",
]
