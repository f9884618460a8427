"""Calibrated views of one object, and the box that holds it."""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError, SceneError
from recon3d.kernels.types import Cameras
from recon3d.scene.bounds import Bounds, place_text
from recon3d.scene.enclosing import enclosing_box
from recon3d.scene.not_seen import why_not_seen
from recon3d.scene.packed import PackedViews, pack_cameras
from recon3d.scene.photograph import Photograph
from recon3d.scene.view import View
from recon3d.summary import Summarised, thumbnails
from recon3d.values import ByContent, Once

NO_SILHOUETTES = "no silhouettes"
"""Note of why none were made where none are known."""

_PICTURED = 48  # photographs at most
_PROBES = 512  # places in the bounds
_QUESTION = "Is this another data set's box, or are the matrices camera-to-world?"


@dataclass(frozen=True, repr=False, eq=False)
class Scene(ByContent, Summarised):
    """Calibrated views of one object, the box that holds it, and what a world unit means."""

    views: tuple[View, ...]
    """At least one; names differ."""
    bounds: Bounds
    """Box around the object, world units; every voxel grid is made inside it. Open3D's box is taken, too."""
    name: str = "scene"
    """Used in titles and file names."""
    mm_per_unit: float | None = 1000.0
    """Millimetres in one world unit; 1000: the world is in metres; None: no scale is known."""
    notes: dict[str, str] = field(default_factory=dict)
    """Where it came from, for tables and the run's record."""
    _packings: dict[float, Once[PackedViews]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", tuple(self.views))
        if not self.views:
            raise SceneError(f"scene {self.name}: expected at least one view")
        names = [view.name for view in self.views]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise SceneError(f"scene {self.name}: views share a name: {', '.join(repeated)}")
        object.__setattr__(self, "notes", dict(self.notes))
        if self.mm_per_unit is not None and not 0 < self.mm_per_unit < np.inf:
            raise ArgumentError(f"scene {self.name}: expected mm_per_unit > 0, got {self.mm_per_unit}")
        object.__setattr__(self, "bounds", Bounds.of(self.bounds))
        if self.bounds.extent.min() <= 0:
            raise SceneError(f"scene {self.name}: expected bounds with three positive sides, got {self.bounds.extent}")
        probes = np.vstack([self.bounds.corners, self.bounds.center, self.bounds.places(_PROBES)])
        if not any(view.sees(probes).any() for view in self.views):
            low, high = (place_text(corner, self.bounds.longest) for corner in (self.bounds.low, self.bounds.high))
            raise SceneError(
                f"scene {self.name}: no camera sees the bounds {low} to {high}. "
                f"{why_not_seen(self.views, self.bounds) or _QUESTION}"
            )

    @classmethod
    def from_arrays(
        cls,
        images: Sequence[Photograph | Path | str | NDArray[np.uint8]],
        K: ArrayLike,
        cam_from_world: ArrayLike,
        *,
        bounds: Bounds | o3d.geometry.AxisAlignedBoundingBox | tuple[ArrayLike, ArrayLike] | None = None,
        silhouettes: Sequence[Path | str | NDArray[np.bool_] | None] | None = None,
        distortion: ArrayLike = (),
        names: Sequence[str] | None = None,
        name: str = "scene",
        mm_per_unit: float | None = 1000.0,
    ) -> Scene:
        """Scene of n photographs and the matrices of their cameras.

        Parameters
        ----------
        images : files, or (height, width, 3) RGB arrays.
        K : (3, 3), or (n, 3, 3) where the cameras differ; pixels, pixel centres at integers.
        cam_from_world : (n, 3, 4) or (n, 4, 4); world to camera, OpenCV's axes (x right, y down, z forward).
        bounds : of the object, or two corners of them; found from the silhouettes, or from what most cameras see, when
            None.
        silhouettes : of each view, files or bool arrays, or None for a view without one.
        distortion : (k,) OpenCV's coefficients, or (n, k).
        names : of the views; those of the files, or numbers, when None.

        Raises
        ------
        ArgumentError : the lengths or shapes do not go together.
        SceneError : the cameras do not look at the bounds, or at one place where none are given.
        """
        n = len(images)
        poses = np.asarray(cam_from_world, np.float64)
        if not n or poses.ndim != 3 or len(poses) != n:
            raise ArgumentError(f"expected a pose for each of {n} images, got cam_from_world of shape {poses.shape}")
        intrinsics, lenses = np.asarray(K, np.float64), np.asarray(distortion, np.float64)
        intrinsics = np.broadcast_to(intrinsics, (n, 3, 3)) if intrinsics.ndim == 2 else intrinsics
        lenses = np.broadcast_to(lenses, (n, len(lenses))) if lenses.ndim == 1 else lenses
        masks = [None] * n if silhouettes is None else silhouettes
        called = _called(images) if names is None else names
        for what, given in (("K", intrinsics), ("distortion", lenses), ("silhouettes", masks), ("names", called)):
            if len(given) != n:
                raise ArgumentError(f"expected {what} for each of {n} images, got {len(given)}")
        views = tuple(
            View.from_matrices(own_K, pose, image, silhouette=mask, distortion=lens, name=own_name)
            for own_K, pose, image, mask, lens, own_name in zip(
                intrinsics, poses, images, masks, lenses, called, strict=True
            )
        )
        box, how = (bounds, None) if bounds is not None else enclosing_box(views)
        return cls(views, Bounds.of(box), name, mm_per_unit, {} if how is None else {"bounds": how})

    def corners_in_views(self) -> NDArray[np.int64]:
        """(n_views,) how many corners of the bounds each image holds."""
        corners = self.bounds.corners
        return np.array([int(view.sees(corners).sum()) for view in self.views])

    def __getstate__(self) -> dict[str, object]:
        return {**super().__getstate__(), "_packings": {}}

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

    def shrunk(self, scale: float) -> Scene:
        """The same scene of photographs at a scale of at most 1: cameras, pixels and masks."""
        return self if scale == 1 else replace(self, views=tuple(view.shrunk(scale) for view in self.views))

    def fingerprint(self) -> str:
        """Text that two scenes share only where views, silhouettes, bounds and unit are the same, to the last bit.

        Photographs and masks count by what they are made from: the bytes of a file, an array, or a recipe.
        """
        told = (*(view.fingerprint() for view in self.views), self.bounds, self.mm_per_unit and float(self.mm_per_unit))
        return hashlib.sha256(repr(told).encode()).hexdigest()

    @property
    def packed(self) -> PackedViews:
        """All views as arrays for kernels; made when first asked for."""
        return self.packed_at(1.0)

    def packed_at(self, scale: float) -> PackedViews:
        """All views at a scale of at most 1 as arrays for kernels; each scale's made once, when first asked for."""
        return self._packings.setdefault(scale, Once()).get(lambda: PackedViews(self.views, scale))

    @property
    def cameras(self) -> Cameras:
        """All views' cameras for kernels; reads no pixels."""
        return pack_cameras([view.calibration for view in self.views])

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n_views, 3) camera centres in the world."""
        return np.array([view.center for view in self.views])

    @property
    def camera_inside(self) -> bool:
        """Whether some camera stands inside the bounds, as in a room."""
        return bool((np.abs(self.centers - self.bounds.center) < self.bounds.extent / 2).all(axis=1).any())

    @property
    def pixel_footprint(self) -> float:
        """Median size of a pixel at the centre of the bounds, world units.

        Where the centre lies behind every camera, or cameras stand inside the bounds, of what each view sees of them.
        """
        focals = [np.sqrt(view.K[0, 0] * view.K[1, 1]) for view in self.views]
        depths = [float(view.project(self.bounds.center[None])[1][0]) for view in self.views]
        if self.camera_inside or max(depths) <= 0:
            places = self.bounds.places(_PROBES)
            seen = [view.project(places)[1][view.sees(places)] for view in self.views]
            depths = [float(np.median(each)) if len(each) else 0.0 for each in seen]
        sizes = [depth / focal for depth, focal in zip(depths, focals, strict=True) if depth > 0]
        if not sizes:
            raise SceneError(f"scene {self.name}: the centre of the bounds lies behind every camera")
        return float(np.median(sizes))

    def known_scale(self) -> float:
        """``mm_per_unit``, for what is measured in millimetres.

        Raises
        ------
        SceneError : no scale is known.
        """
        if self.mm_per_unit is None:
            raise SceneError(
                f"scene {self.name}: no scale is known, so nothing can be measured in millimetres; give "
                "mm_per_unit (--mm-per-unit)"
            )
        return self.mm_per_unit

    def length(self, *sides: float, digits: int = 3) -> str:
        """Text of lengths in world units: millimetres, or "units (no scale)"."""
        told = " x ".join(f"{side * (self.mm_per_unit or 1):.{digits}g}" for side in sides)
        return f"{told} {'mm' if self.mm_per_unit else 'units (no scale)'}"

    def summary(self) -> dict[str, object]:
        """Table of what the scene holds."""
        sizes = sorted({f"{view.width}x{view.height}" for view in self.views})
        return {
            "name": self.name,
            "views": len(self.views),
            "image size": ", ".join(sizes),
            "silhouettes": sum(view.has_silhouette for view in self.views),
            "extent": self.length(*self.bounds.extent, digits=4),
            "pixel footprint": self.length(self.pixel_footprint),
            **self.notes,
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB photographs, small; some evenly chosen ones of many views."""
        chosen = np.unique(np.linspace(0, len(self.views) - 1, min(_PICTURED, len(self.views))).round().astype(int))
        return thumbnails((self.views[n].image for n in chosen), width=120, columns=4)


def _called(images: Sequence[Photograph | Path | str | NDArray[np.uint8]]) -> list[str]:
    """Names of views: those of the files, or numbers where there are none or where they are the same."""
    files = [Path(image).name for image in images if isinstance(image, (str, Path))]
    if len(set(files)) == len(images):
        return files
    return [f"view{n + 1:0{len(str(len(images)))}d}" for n in range(len(images))]
