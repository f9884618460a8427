"""One calibrated photograph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError
from recon3d.scene.camera import Camera
from recon3d.scene.mask import Mask
from recon3d.scene.photograph import Photograph
from recon3d.summary import Summarised
from recon3d.values import ByContent


@dataclass(frozen=True, init=False, repr=False, eq=False)
class View(ByContent, Summarised):
    """One calibrated photograph.

    ``View(camera, image, silhouette, name)`` takes Open3D's ``PinholeCameraParameters``, an RGB array
    (height, width, 3) and a bool mask (height, width), or a ``Camera`` and image files. A view is of the undistorted
    photograph: that is what ``image``, ``silhouette``, ``K`` and ``camera`` show.

    Raises
    ------
    ArgumentError : camera, photograph and mask do not fit together.
    """

    calibration: Camera
    """The camera, with the distortion of its lens."""
    photograph: Photograph
    """The photograph as it was taken, in memory or in a file."""
    mask: Mask | None
    """Where in the photograph the object may be; None: not known."""
    name: str
    """What errors and tables call it, usually the file's name."""

    def __init__(
        self,
        calibration: Camera | o3d.camera.PinholeCameraParameters,
        photograph: Photograph | Path | str | NDArray[np.uint8],
        mask: Mask | Path | str | NDArray[np.bool_] | None = None,
        name: str = "view",
    ) -> None:
        try:
            camera, photograph = Camera.of(calibration), Photograph.of(photograph)
            mask = None if mask is None else Mask.of(mask)
        except ValueError as error:
            raise ArgumentError(f"view {name}: {error}") from None
        expected = (camera.width, camera.height)
        for what, size in (("image", photograph.size), ("silhouette", mask.size if mask else expected)):
            if size != expected:
                raise ArgumentError(
                    f"view {name}: the camera is for {camera.width}x{camera.height} pixels, "
                    f"the {what} has {size[0]}x{size[1]}"
                )
        object.__setattr__(self, "calibration", camera)
        object.__setattr__(self, "photograph", photograph)
        object.__setattr__(self, "mask", mask)
        object.__setattr__(self, "name", name)

    @classmethod
    def from_matrices(
        cls,
        K: ArrayLike,
        cam_from_world: ArrayLike,
        image: Photograph | Path | str | NDArray[np.uint8],
        *,
        silhouette: Mask | Path | str | NDArray[np.bool_] | None = None,
        distortion: ArrayLike = (),
        name: str = "view",
    ) -> View:
        """View from K (3, 3) and a world-to-camera transform, (3, 4) or (4, 4); x points right, y down, z forward."""
        try:
            photograph = Photograph.of(image)
            camera = Camera(K, cam_from_world, *photograph.size, distortion)
        except ValueError as error:
            raise ArgumentError(f"view {name}: {error}") from None
        return cls(camera, photograph, silhouette, name)

    @classmethod
    def from_projection(
        cls,
        P: ArrayLike,
        image: Photograph | Path | str | NDArray[np.uint8],
        *,
        seen: ArrayLike | None = None,
        silhouette: Mask | Path | str | NDArray[np.bool_] | None = None,
        name: str = "view",
    ) -> View:
        """View from a 3x4 projection matrix P = s K [R | t], world to homogeneous pixels, of any scale s.

        Parameters
        ----------
        seen : (3,) a world point in front of the camera, such as the middle of the bounds, which settles the sign of
            P; without it s is taken to be positive.

        Raises
        ------
        ArgumentError : P is no projection of a right-handed world; says how to mirror a left-handed one.
        """
        try:
            photograph = Photograph.of(image)
            camera = Camera.from_projection(P, *photograph.size, seen=seen)
        except ValueError as error:
            raise ArgumentError(f"view {name}: {error}") from None
        return cls(camera, photograph, silhouette, name)

    @property
    def camera(self) -> o3d.camera.PinholeCameraParameters:
        """Open3D's camera: the full K (skew, fx != fy) and the extrinsic ``cam_from_world``."""
        return self.calibration.to_open3d()

    @property
    def image(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB, read-only; read from the file where the process does not hold it."""
        return self.image_at(1.0)

    @property
    def silhouette(self) -> NDArray[np.bool_] | None:
        """(height, width), True where the object may be; None: not known. Outside the image it is always unknown."""
        return self.silhouette_at(1.0)

    @property
    def may_show_object(self) -> NDArray[np.bool_]:
        """(height, width) the silhouette; all pixels where it is not known."""
        silhouette = self.silhouette
        return np.ones((self.height, self.width), np.bool_) if silhouette is None else silhouette

    @property
    def has_silhouette(self) -> bool:
        """Whether a silhouette is known; reads no pixels."""
        return self.mask is not None

    def image_at(self, scale: float) -> NDArray[np.uint8]:
        """(height, width, 3) RGB at a scale of at most 1: a pixel is the mean of what it covers."""
        return self.photograph.read(scale, camera=self.calibration)

    def silhouette_at(self, scale: float) -> NDArray[np.bool_] | None:
        """(height, width) silhouette at a scale of at most 1: a pixel may be object where any that it covers may."""
        if self.mask is None:
            return None
        whole = self.mask.read(self.calibration)
        camera = self.calibration.at(scale)
        if whole.shape == (camera.height, camera.width):
            return whole
        share = cv2.resize(whole.astype(np.float32), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return np.asarray(share > 1e-6)

    def shrunk(self, scale: float) -> View:
        """The view of the photograph at a scale of at most 1, its width and height rounded to whole pixels.

        Pixels of the photograph are the means of what they cover, and K keeps each on its ray.
        """
        camera = self.calibration.at(scale)
        if camera is self.calibration:
            return self
        mask = None if self.mask is None else self.mask.shrunk(scale)
        return View(camera, self.photograph.shrunk(camera.width, camera.height), mask, self.name)

    @property
    def height(self) -> int:
        """Rows."""
        return self.calibration.height

    @property
    def width(self) -> int:
        """Columns."""
        return self.calibration.width

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) intrinsic matrix, pixels."""
        return self.calibration.K.copy()

    @property
    def cam_from_world(self) -> NDArray[np.float64]:
        """(4, 4) rigid transform."""
        return self.calibration.cam_from_world.copy()

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

    def fingerprint(self) -> str:
        """Text that two views share only where name, camera, photograph and mask are the same; decodes no pixels."""
        camera = self.calibration
        numbers = [*camera.K.ravel(), *camera.cam_from_world.ravel(), *camera.distortion]
        mask = self.mask.fingerprint() if self.mask else None
        return repr((self.name, *map(float, numbers), self.photograph.fingerprint(), mask))

    def summary(self) -> dict[str, object]:
        """Table of what the view is."""
        return {
            "name": self.name,
            "image size": f"{self.width}x{self.height}",
            "silhouette": "known" if self.has_silhouette else "not known",
            "focal lengths (pixels)": f"{self.K[0, 0]:.1f}, {self.K[1, 1]:.1f}",
            "centre": ", ".join(f"{x:.10g}" for x in self.center),
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB photograph."""
        return self.image
