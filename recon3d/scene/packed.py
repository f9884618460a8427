"""The views as arrays that kernels can read."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from os import cpu_count

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.kernels.types import Cameras
from recon3d.scene.camera import Camera
from recon3d.scene.view import View


def pack_cameras(cameras: Sequence[Camera]) -> Cameras:
    """Cameras as kernels read them."""
    packed = Cameras(
        projections=np.stack([camera.K @ camera.cam_from_world[:3] for camera in cameras]),
        world_from_pixel=np.stack([camera.cam_from_world[:3, :3].T @ np.linalg.inv(camera.K) for camera in cameras]),
        centers=np.stack([-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3] for camera in cameras]),
        focals=np.array([np.sqrt(abs(np.linalg.det(camera.K[:2, :2]))) for camera in cameras]),
        sizes=np.array([(camera.width, camera.height) for camera in cameras]),
    )
    for array in packed:
        array.setflags(write=False)
    return packed


class PackedViews:
    """Views at a scale, of different sizes, as stacked arrays, padded at the right and below; never changed.

    Pixels and matrices are those of the scaled photographs.
    """

    images: NDArray[np.uint8]
    """(n_views, height, width, 3) RGB."""
    foreground: NDArray[np.bool_]
    """(n_views, height, width) pixels that may show the object; all of a view without silhouette."""
    cameras: Cameras

    def __init__(self, views: Sequence[View], scale: float = 1.0) -> None:
        cameras = [view.calibration.at(scale) for view in views]
        height, width = max(camera.height for camera in cameras), max(camera.width for camera in cameras)
        self.images = np.zeros((len(views), height, width, 3), np.uint8)
        self.foreground = np.zeros((len(views), height, width), np.bool_)

        def fill(n: int) -> None:
            silhouette = views[n].silhouette_at(scale)
            part = np.s_[n, : cameras[n].height, : cameras[n].width]
            self.images[part] = views[n].image_at(scale)
            self.foreground[part] = True if silhouette is None else silhouette

        with ThreadPoolExecutor(cpu_count()) as pool:  # decoding and OpenCV release the interpreter lock
            list(pool.map(fill, range(len(views))))
        self.cameras = pack_cameras(cameras)
        for array in (self.images, self.foreground):
            array.setflags(write=False)

    @cached_property
    def integrals(self) -> NDArray[np.int32]:
        """(n_views, height + 1, width + 1) summed-area tables of the foreground; made when first asked for."""
        tables = np.stack([cv2.integral(mask.view(np.uint8)) for mask in self.foreground])
        tables.setflags(write=False)
        return tables

    def __len__(self) -> int:
        """Number of views."""
        return len(self.images)
