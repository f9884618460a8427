"""The views as arrays that kernels can read."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.view import View


class PackedViews:
    """Views of different sizes as stacked arrays, padded at the right and below; made once, never changed."""

    images: NDArray[np.uint8]
    """(n_views, height, width, 3) RGB."""
    foreground: NDArray[np.bool_]
    """(n_views, height, width) pixels that may show the object; all of a view without silhouette."""
    integrals: NDArray[np.int32]
    """(n_views, height + 1, width + 1) summed-area tables of the foreground."""
    sizes: NDArray[np.int64]
    """(n_views, 2) width and height, pixels."""
    projections: NDArray[np.float64]
    """(n_views, 3, 4) P = K [R | t]."""
    centers: NDArray[np.float64]
    """(n_views, 3) camera centres, world."""
    world_from_pixel: NDArray[np.float64]
    """(n_views, 3, 3) R^T K^-1: from homogeneous pixels to ray directions of depth one, world."""
    focals: NDArray[np.float64]
    """(n_views,) focal lengths, pixels."""

    def __init__(self, views: Sequence[View]) -> None:
        height, width = max(view.height for view in views), max(view.width for view in views)
        self.images = np.zeros((len(views), height, width, 3), np.uint8)
        self.foreground = np.zeros((len(views), height, width), np.bool_)
        for n, view in enumerate(views):
            self.images[n, : view.height, : view.width] = view.image
            self.foreground[n, : view.height, : view.width] = True if view.silhouette is None else view.silhouette
        self.integrals = np.stack([cv2.integral(mask.astype(np.uint8)) for mask in self.foreground])
        self.sizes = np.array([(view.width, view.height) for view in views])
        self.projections = np.stack([view.projection for view in views])
        self.centers = np.stack([view.center for view in views])
        self.world_from_pixel = np.stack([view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) for view in views])
        self.focals = np.array([np.sqrt(abs(np.linalg.det(view.K[:2, :2]))) for view in views])
        for array in vars(self).values():
            array.setflags(write=False)

    def __len__(self) -> int:
        """Number of views."""
        return len(self.sizes)
