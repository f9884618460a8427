"""The views as arrays that kernels can read."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.consistency import Patches
from recon3d.kernels.footprints import carve_background, free_pixels, gather
from recon3d.scene import Scene
from recon3d.volume import CarvingVolume


class ViewArrays:
    """The views as stacked arrays, and the pixels that no accepted voxel has claimed."""

    def __init__(self, scene: Scene) -> None:
        views = scene.views
        height, width = max(view.height for view in views), max(view.width for view in views)
        self.projections = np.stack([view.projection for view in views])
        self.sizes = np.array([(view.width, view.height) for view in views])
        self.images = np.zeros((len(views), height, width, 3), np.uint8)
        self.free = np.zeros((len(views), height, width), np.bool_)
        for n, view in enumerate(views):
            self.images[n, : view.height, : view.width] = view.image
            self.free[n, : view.height, : view.width] = True if view.silhouette is None else view.silhouette
        self.foreground = self.free.copy()
        self.centers = np.stack([view.center for view in views])
        self.focals = np.array([np.sqrt(abs(np.linalg.det(view.K[:2, :2]))) for view in views])  # pixels
        self.world_from_pixel = np.stack([view.cam_from_world[:3, :3].T @ np.linalg.inv(view.K) for view in views])
        self.integrals = np.stack([cv2.integral(mask.astype(np.uint8)) for mask in self.free])

    def carve_background(self, occupied: NDArray[np.bool_], volume: CarvingVolume) -> None:
        """Clear voxels that project to background alone."""
        carve_background(occupied, volume.origin, volume.voxel_size, self.projections, self.sizes, self.integrals)

    def footprints(
        self, voxels: NDArray[np.int64], volume: CarvingVolume
    ) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.bool_]]:
        """Boxes B_j(v) (n, n_views, 4), sizes of P_j(v) (n, n_views) (eq. 5), and whether any image shows the voxel."""
        boxes = np.empty((len(voxels), len(self.free), 4), np.int32)
        counts = np.empty((len(voxels), len(self.free)), np.int64)
        in_frame = np.zeros(len(voxels), np.bool_)
        free_pixels(
            voxels, volume.origin, volume.voxel_size, self.projections, self.sizes, self.integrals, self.free,
            boxes, counts, in_frame,
        )  # fmt: skip
        return boxes, counts, in_frame

    def patches(self, boxes: NDArray[np.int32], counts: NDArray[np.int64]) -> Patches:
        """P(v) of every voxel of the batch."""
        ends = np.cumsum(counts).reshape(counts.shape)
        view_starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
        colors = np.empty((int(ends[-1, -1]) if ends.size else 0, 3), np.uint8)
        gather(boxes, view_starts, self.free, self.images, colors)
        return Patches(colors, view_starts)
