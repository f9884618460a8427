"""A calibrated camera: intrinsic matrix, pose, size and lens distortion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError
from recon3d.values import ByContent

ROTATION_TOLERANCE = 1e-3  # published matrices are rounded
_N_COEFFICIENTS = (0, 4, 5, 8, 12, 14)  # that OpenCV knows


@dataclass(frozen=True, init=False, eq=False)
class Camera(ByContent):
    """K, pose and size of a photograph in pixels, with the distortion of its lens.

    K (3, 3) and pose, (4, 4) or (3, 4), are those of the pinhole camera that the undistorted photograph is of. It has
    the same K and the same size as the photograph itself: the scale at the principal point is kept, and what leaves the
    frame is cut off.

    Raises
    ------
    ArgumentError : K is no intrinsic matrix, the pose is not rigid, or the size or the number of coefficients is wrong.
    """

    K: NDArray[np.float64]
    """(3, 3) [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], pixels, pixel centres at integers; read-only."""
    cam_from_world: NDArray[np.float64]
    """(4, 4) rigid transform; read-only."""
    width: int
    """Columns."""
    height: int
    """Rows."""
    distortion: tuple[float, ...]
    """OpenCV's coefficients k1, k2, p1, p2, k3 and so on (4, 5, 8, 12 or 14); empty: none."""

    def __init__(
        self, K: ArrayLike, cam_from_world: ArrayLike, width: int, height: int, distortion: ArrayLike = ()
    ) -> None:
        intrinsic, given = np.array(K, np.float64), np.asarray(cam_from_world, np.float64)
        if intrinsic.shape != (3, 3) or given.shape not in ((3, 4), (4, 4)):
            raise ArgumentError(
                f"expected a 3x3 K and a 3x4 or 4x4 cam_from_world, got shapes {intrinsic.shape} and {given.shape}"
            )
        extrinsic = np.eye(4)
        extrinsic[: len(given)] = given
        coefficients = tuple(np.asarray(distortion, np.float64).ravel().tolist())
        problem = _wrong_intrinsics(intrinsic) or _wrong_extrinsics(extrinsic)
        if width < 1 or height < 1:
            problem = problem or f"expected a size of at least 1x1 pixels, got {width}x{height}"
        if len(coefficients) not in _N_COEFFICIENTS or not np.isfinite(coefficients).all():
            problem = problem or (
                f"expected 4, 5, 8, 12 or 14 finite distortion coefficients, or none, got {coefficients}"
            )
        if problem:
            raise ArgumentError(problem)
        intrinsic.setflags(write=False)
        extrinsic.setflags(write=False)
        object.__setattr__(self, "K", intrinsic)
        object.__setattr__(self, "cam_from_world", extrinsic)
        object.__setattr__(self, "width", int(width))
        object.__setattr__(self, "height", int(height))
        object.__setattr__(self, "distortion", coefficients if any(coefficients) else ())

    @classmethod
    def from_projection(
        cls, P: ArrayLike, width: int, height: int, distortion: ArrayLike = (), *, seen: ArrayLike | None = None
    ) -> Camera:
        """The camera of a 3x4 (or 4x4) matrix P = s K [R | t], whatever its scale s.

        Parameters
        ----------
        seen : (3,) a world point in front of the camera, which settles the sign of P; without it s is taken to be
            positive.

        Raises
        ------
        ArgumentError : P is no projection of a right-handed world.

        References
        ----------
        Hartley, Zisserman, "Multiple View Geometry in Computer Vision", 2004, section 6.2.4.
        """
        given = np.array(P, np.float64)
        if given.shape not in ((3, 4), (4, 4)) or not np.isfinite(given[:3]).all():
            raise ArgumentError(f"expected a projection matrix of 3x4 finite numbers, got shape {given.shape}")
        matrix = given[:3]
        if seen is not None and matrix[2] @ np.append(np.asarray(seen, np.float64), 1.0) < 0:
            matrix = -matrix
        determinant = np.linalg.det(matrix[:, :3] / max(float(np.linalg.norm(matrix[2, :3])), 1e-300))
        if abs(determinant) < 1e-12:
            raise ArgumentError("expected a projection matrix of a camera at a finite place, got a singular one")
        if determinant < 0:
            sign = (
                "Give -P, or a point that the camera sees, where the sign is wrong; else the" if seen is None else "The"
            )
            raise ArgumentError(
                f"the determinant of P's left 3x3 part is negative. {sign} world is left-handed: mirror one of its "
                "axes, P @ numpy.diag([1, 1, -1, 1]), in all views and in the bounds"
            )
        # RQ decomposition by the QR decomposition of the rows and columns in reverse order.
        Q, upper = np.linalg.qr(matrix[::-1, :3].T)
        K, R = upper.T[::-1, ::-1], Q.T[::-1]
        signs = np.sign(np.diag(K))
        K, R = K * signs, signs[:, None] * R
        t = np.linalg.solve(K, matrix[:, 3])
        return cls(np.triu(K / K[2, 2]), np.column_stack([R, t]), width, height, distortion)

    @classmethod
    def of(cls, camera: Camera | o3d.camera.PinholeCameraParameters) -> Camera:
        """The camera itself, or that of Open3D's parameters."""
        if isinstance(camera, Camera):
            return camera
        intrinsic = camera.intrinsic
        return cls(intrinsic.intrinsic_matrix, camera.extrinsic, intrinsic.width, intrinsic.height)

    def __hash__(self) -> int:
        return hash((*self.K.ravel().tolist(), *self.cam_from_world.ravel().tolist(), *self._rest))

    def __reduce__(self) -> tuple[type[Camera], tuple[object, ...]]:
        return Camera, (self.K, self.cam_from_world, *self._rest)

    @property
    def _rest(self) -> tuple[int, int, tuple[float, ...]]:
        return self.width, self.height, self.distortion

    def to_open3d(self) -> o3d.camera.PinholeCameraParameters:
        """Open3D's parameters of the pinhole camera."""
        camera = o3d.camera.PinholeCameraParameters()
        intrinsic = o3d.camera.PinholeCameraIntrinsic()
        intrinsic.width, intrinsic.height = self.width, self.height
        intrinsic.intrinsic_matrix = self.K
        camera.intrinsic = intrinsic
        camera.extrinsic = self.cam_from_world
        return camera

    def scaled(self, width: int, height: int) -> Camera:
        """The camera of the whole photograph resized to a width and height: u' = s (u + 0.5) - 0.5, likewise v."""
        sx, sy = width / self.width, height / self.height
        scaling = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
        return replace(self, K=scaling @ self.K, width=width, height=height)

    def at(self, scale: float) -> Camera:
        """The camera of the photograph at a scale, its width and height rounded to whole pixels, at least one."""
        return self if scale == 1 else self.scaled(*scaled_size(self.width, self.height, scale))

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a part of the photograph, whose upper left pixel is (left, top)."""
        shift = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]])
        return replace(self, K=shift @ self.K, width=width, height=height)

    def undistorted(self, picture: NDArray[np.uint8], *, beyond: int | None = None) -> NDArray[np.uint8]:
        """A picture (height, width) or (height, width, 3) as the pinhole camera shows it; the same without distortion.

        Parameters
        ----------
        beyond : value of pixels that the picture does not show; those of its border, continued, when None.
        """
        if not self.distortion:
            return picture
        # With an identity for the lens' K the maps hold where each ray meets the distorted plane of depth one.
        size, coefficients = (self.width, self.height), np.array(self.distortion)
        x, y = cv2.initUndistortRectifyMap(np.eye(3), coefficients, np.eye(3), self.K, size, cv2.CV_32FC1)
        u = self.K[0, 0] * x + self.K[0, 1] * y + self.K[0, 2]
        v = self.K[1, 1] * y + self.K[1, 2]
        border = {"borderMode": cv2.BORDER_REPLICATE} if beyond is None else {"borderValue": (beyond,) * 3}
        found = cv2.remap(picture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, **border)
        return np.asarray(found, np.uint8)

    def shown(self) -> NDArray[np.bool_]:
        """(height, width) pixels of the undistorted picture that the photograph shows."""
        return self.undistorted(np.full((self.height, self.width), 255, np.uint8), beyond=0) > 127


def scaled_size(width: int, height: int, scale: float) -> tuple[int, int]:
    """Width and height at a scale, rounded to whole pixels, at least one."""
    if not 0 < scale <= 1:
        raise ArgumentError(f"expected a scale above 0 and at most 1, got {scale}")
    return max(1, round(scale * width)), max(1, round(scale * height))


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether one width and height is the other one scaled and rounded to whole pixels."""
    (small_width, small_height), (width, height) = sorted((size, other))
    off = abs(small_width - small_height * width / height)
    return (small_width == width) == (small_height == height) and off <= (1 + width / height) / 2


def _wrong_intrinsics(K: NDArray[np.float64]) -> str | None:
    """What is wrong with a 3x3 intrinsic matrix, or None."""
    if not np.isfinite(K).all():
        return "K holds a number that is not finite"
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        return f"expected positive focal lengths, got fx={K[0, 0]:g}, fy={K[1, 1]:g}"
    if np.abs([K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1.0]).max() > 1e-9:
        return "expected K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
    return None


def _wrong_extrinsics(cam_from_world: NDArray[np.float64]) -> str | None:
    """What is wrong with a 4x4 rigid transform, or None."""
    if not np.isfinite(cam_from_world).all():
        return "R or t holds a number that is not finite"
    R = cam_from_world[:3, :3]
    error = np.abs(R @ R.T - np.eye(3)).max()
    if error > ROTATION_TOLERANCE:
        return f"R is not a rotation: R R^T differs from the identity by {error:.3g}"
    if np.linalg.det(R) < 0:
        return (
            "R is not a rotation: its determinant is -1 (a reflection). The world is left-handed, or an axis of the "
            "camera points the other way: mirror an axis of the world, a column of R in all views and that axis of the "
            "bounds, or negate that row of R and t"
        )
    if np.abs(cam_from_world[3] - [0, 0, 0, 1]).max() > 1e-9:
        return "expected the last row 0 0 0 1"
    return None
