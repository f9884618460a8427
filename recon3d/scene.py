"""Calibrated views and the scene that they show."""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import SceneError
from recon3d.html import Summarised, thumbnails

ROTATION_TOLERANCE = 1e-3  # published matrices are rounded


def check_intrinsics(K: NDArray[np.float64]) -> str | None:
    """What is wrong with a 3x3 intrinsic matrix, or None."""
    if not np.isfinite(K).all():
        return "K holds a number that is not finite"
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        return f"expected positive focal lengths, got fx={K[0, 0]:g}, fy={K[1, 1]:g}"
    if np.abs([K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1.0]).max() > 1e-9:
        return "expected K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
    return None


def check_extrinsics(cam_from_world: NDArray[np.float64]) -> str | None:
    """What is wrong with a 4x4 rigid transform, or None."""
    if not np.isfinite(cam_from_world).all():
        return "R or t holds a number that is not finite"
    R = cam_from_world[:3, :3]
    error = np.abs(R @ R.T - np.eye(3)).max()
    if error > ROTATION_TOLERANCE:
        return f"R is not a rotation: R R^T differs from the identity by {error:.3g}"
    if np.linalg.det(R) < 0:
        return "R is not a rotation: its determinant is -1 (a reflection)"
    if np.abs(cam_from_world[3] - [0, 0, 0, 1]).max() > 1e-9:
        return "expected the last row 0 0 0 1"
    return None


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
            "silhouette": "known" if self.silhouette is not None else "not known",
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


def make_bounds(low: ArrayLike, high: ArrayLike) -> o3d.geometry.AxisAlignedBoundingBox:
    """Axis-aligned box from two opposite corners (3,) in world units."""
    a, b = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if a.shape != (3,) or b.shape != (3,) or not np.isfinite([a, b]).all():
        raise ValueError(f"expected two corners of three finite numbers, got {low!r} and {high!r}")
    return o3d.geometry.AxisAlignedBoundingBox(np.minimum(a, b), np.maximum(a, b))


def bounds_corners(bounds: o3d.geometry.AxisAlignedBoundingBox) -> NDArray[np.float64]:
    """(8, 3) corners of a box."""
    sides = np.stack([bounds.min_bound, bounds.max_bound])
    return np.array([[sides[c, axis] for axis, c in enumerate(corner)] for corner in product((0, 1), repeat=3)])


@dataclass(frozen=True, repr=False)
class Scene(Summarised):
    """Calibrated views of one object, the box that holds it, and what a world unit means."""

    views: tuple[View, ...]
    """At least one; names differ."""
    bounds: o3d.geometry.AxisAlignedBoundingBox
    """Box around the object, world units; every voxel grid is made inside it."""
    name: str = "scene"
    """Used in titles and file names."""
    mm_per_unit: float = 1000.0
    """Millimetres in one world unit; 1000: the world is in metres."""
    notes: dict[str, str] = field(default_factory=dict)
    """Where it came from, for tables and the run's record."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        if not self.views:
            raise SceneError(f"scene {self.name}: expected at least one view")
        names = [view.name for view in self.views]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise SceneError(f"scene {self.name}: views share a name: {', '.join(repeated)}")
        object.__setattr__(self, "notes", dict(self.notes))
        if not 0 < self.mm_per_unit < np.inf:
            raise ValueError(f"scene {self.name}: expected mm_per_unit > 0, got {self.mm_per_unit}")
        extent = np.asarray(self.bounds.get_extent())
        if not (np.isfinite(extent).all() and (extent > 0).all()):
            raise SceneError(f"scene {self.name}: expected bounds with three positive sides, got {extent}")
        probes = np.vstack([bounds_corners(self.bounds), self.bounds.get_center()])
        if not any(view.sees(probes).any() for view in self.views):
            raise SceneError(
                f"scene {self.name}: no camera sees the bounds {self.bounds.min_bound} to {self.bounds.max_bound}. "
                "Is this another data set's box, or are the matrices camera-to-world?"
            )

    def corners_in_views(self) -> NDArray[np.int64]:
        """(n_views,) how many corners of the bounds each image holds."""
        corners = bounds_corners(self.bounds)
        return np.array([int(view.sees(corners).sum()) for view in self.views])

    def subset(self, names: Iterable[str]) -> Scene:
        """The same scene with only the named views, in scene order; a name may hold the wildcards * ? [1-8]."""
        known = [view.name for view in self.views]
        chosen: set[str] = set()
        for name in names:
            found = [name] if name in known else fnmatch.filter(known, name)
            if not found:
                raise SceneError(f"scene {self.name} has no view {name}; it has {', '.join(known)}")
            chosen.update(found)
        return replace(self, views=tuple(view for view in self.views if view.name in chosen))

    def fingerprint(self) -> str:
        """Text that two scenes share only where views, silhouettes, bounds and unit are the same, to the last bit."""
        digest = hashlib.sha256()
        for view in self.views:
            mask = np.empty(0, np.bool_) if view.silhouette is None else view.silhouette
            digest.update(repr((view.name, view.image.shape, mask.shape)).encode())
            for array in (view.K, view.cam_from_world, view.image, mask):
                digest.update(array.tobytes())
        digest.update(np.array([*self.bounds.min_bound, *self.bounds.max_bound, self.mm_per_unit]).tobytes())
        return digest.hexdigest()

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n_views, 3) camera centres in the world."""
        return np.array([view.center for view in self.views])

    @property
    def pixel_footprint(self) -> float:
        """Median size of a pixel at the centre of the bounds, world units."""
        middle = np.asarray(self.bounds.get_center())[None]
        sizes = [view.project(middle)[1][0] / np.sqrt(view.K[0, 0] * view.K[1, 1]) for view in self.views]
        before = [size for size in sizes if size > 0]
        if not before:
            raise SceneError(f"scene {self.name}: the centre of the bounds lies behind every camera")
        return float(np.median(before))

    def summary(self) -> dict[str, object]:
        """Table of what the scene holds."""
        sizes = sorted({f"{view.width}x{view.height}" for view in self.views})
        return {
            "name": self.name,
            "views": len(self.views),
            "image size": ", ".join(sizes),
            "silhouettes": sum(view.silhouette is not None for view in self.views),
            "bounds (mm)": " x ".join(f"{side:.1f}" for side in self.bounds.get_extent() * self.mm_per_unit),
            "pixel footprint (mm)": f"{self.pixel_footprint * self.mm_per_unit:.3f}",
            **self.notes,
        }

    def picture(self) -> NDArray[np.uint8]:
        """All photographs, small."""
        return thumbnails([view.image for view in self.views], width=120, columns=4)
