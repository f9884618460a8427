"""One calibrated photograph."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.scene.camera import check_extrinsics, check_intrinsics
from recon3d.summary import Summarised


@dataclass(frozen=True, repr=False)
class View(Summarised):
    """One calibrated photograph."""

    camera: o3d.camera.PinholeCameraParameters
    """Open3D camera: the full K (skew, fx != fy) and the extrinsic ``cam_from_world``; pixel centres at integers."""
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    silhouette: NDArray[np.bool_] | None = None
    """(height, width), True where the object may be; None: not known. Outside the image it is always unknown."""
    name: str = "view"
    """What errors and tables call it, usually the file's name."""

    def __post_init__(self) -> None:
        if self.image.dtype != np.uint8 or self.image.ndim != 3 or self.image.shape[2] != 3:
            raise ValueError(
                f"view {self.name}: expected an (height, width, 3) uint8 RGB image, "
                f"got {self.image.shape} {self.image.dtype}"
            )
        intrinsic = self.camera.intrinsic
        if (intrinsic.height, intrinsic.width) != self.image.shape[:2]:
            raise ValueError(
                f"view {self.name}: the camera is for {intrinsic.width}x{intrinsic.height} pixels, "
                f"the image has {self.width}x{self.height}"
            )
        problem = check_intrinsics(self.K) or check_extrinsics(self.cam_from_world)
        if problem:
            raise ValueError(f"view {self.name}: {problem}")
        if self.silhouette is not None and (
            self.silhouette.shape != self.image.shape[:2] or self.silhouette.dtype != np.bool_
        ):
            raise ValueError(
                f"view {self.name}: expected a bool silhouette of {self.width}x{self.height} pixels, "
                f"got shape {self.silhouette.shape} {self.silhouette.dtype}"
            )

    @classmethod
    def from_matrices(
        cls,
        K: ArrayLike,
        cam_from_world: ArrayLike,
        image: NDArray[np.uint8],
        *,
        silhouette: NDArray[np.bool_] | None = None,
        name: str = "view",
    ) -> View:
        """View from a 3x3 K and a 3x4 or 4x4 world-to-camera transform (OpenCV axes: x right, y down, z forward)."""
        camera = o3d.camera.PinholeCameraParameters()
        intrinsic = o3d.camera.PinholeCameraIntrinsic()
        intrinsic.height, intrinsic.width = image.shape[:2]
        intrinsic.intrinsic_matrix = np.asarray(K, np.float64)
        camera.intrinsic = intrinsic
        extrinsic = np.eye(4)
        given = np.asarray(cam_from_world, np.float64)
        extrinsic[: given.shape[0]] = given
        camera.extrinsic = extrinsic
        return cls(camera, image, silhouette, name)

    def __reduce__(self) -> tuple[Callable[..., View], tuple[object, ...]]:
        """Pickle by matrices, since Open3D's cameras do not pickle."""
        return _view_from_parts, (self.K, self.cam_from_world, self.image, self.silhouette, self.name)

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.image.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.image.shape[1])

    @property
    def has_silhouette(self) -> bool:
        """Whether a silhouette is known; asks for no pixels."""
        return self.silhouette is not None

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) intrinsic matrix, pixels."""
        return np.array(self.camera.intrinsic.intrinsic_matrix)

    @property
    def cam_from_world(self) -> NDArray[np.float64]:
        """(4, 4) rigid transform."""
        return np.array(self.camera.extrinsic)

    @property
    def projection(self) -> NDArray[np.float64]:
        """(3, 4) matrix P = K [R | t], world to homogeneous pixels (eq. 1)."""
        return np.asarray(self.K @ self.cam_from_world[:3])

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) camera centre in the world."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels (n, 2) as (u, v) and depths (n,) of world points (n, 3); a depth <= 0 lies behind the camera."""
        homogeneous = points @ self.projection[:, :3].T + self.projection[:, 3]
        depth = homogeneous[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            return homogeneous[:, :2] / depth[:, None], depth

    def sees(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which world points (n, 3) lie in front of the camera and inside the image, occluded or not."""
        pixels, depth = self.project(points)
        return np.asarray(
            (depth > 0)
            & (pixels >= -0.5).all(axis=1)
            & (pixels < np.array([self.width, self.height]) - 0.5).all(axis=1)
        )

    def summary(self) -> dict[str, object]:
        """Table of what the view is."""
        return {
            "name": self.name,
            "image size": f"{self.width}x{self.height}",
            "silhouette": "known" if self.has_silhouette else "not known",
            "focal lengths (pixels)": f"{self.K[0, 0]:.1f}, {self.K[1, 1]:.1f}",
            "centre": ", ".join(f"{x:.4g}" for x in self.center),
        }

    def picture(self) -> NDArray[np.uint8]:
        """The photograph."""
        return self.image


def _view_from_parts(
    K: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    image: NDArray[np.uint8],
    silhouette: NDArray[np.bool_] | None,
    name: str,
) -> View:
    return View.from_matrices(K, cam_from_world, image, silhouette=silhouette, name=name)
