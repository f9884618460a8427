"""Calibrated views of one object, and the box that holds it."""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, SceneError
from recon3d.scene.bounds import Bounds
from recon3d.scene.packed import PackedViews
from recon3d.scene.view import View
from recon3d.summary import Summarised, thumbnails
from recon3d.values import ByContent, Once

_PICTURED = 48  # photographs at most


@dataclass(frozen=True, repr=False, eq=False)
class Scene(ByContent, Summarised):
    """Calibrated views of one object, the box that holds it, and what a world unit means."""

    views: tuple[View, ...]
    """At least one; names differ."""
    bounds: Bounds
    """Box around the object, world units; every voxel grid is made inside it. Open3D's box is taken, too."""
    name: str = "scene"
    """Used in titles and file names."""
    mm_per_unit: float = 1000.0
    """Millimetres in one world unit; 1000: the world is in metres."""
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
        if not 0 < self.mm_per_unit < np.inf:
            raise ArgumentError(f"scene {self.name}: expected mm_per_unit > 0, got {self.mm_per_unit}")
        object.__setattr__(self, "bounds", Bounds.of(self.bounds))
        if self.bounds.extent.min() <= 0:
            raise SceneError(f"scene {self.name}: expected bounds with three positive sides, got {self.bounds.extent}")
        probes = np.vstack([self.bounds.corners, self.bounds.center])
        if not any(view.sees(probes).any() for view in self.views):
            raise SceneError(
                f"scene {self.name}: no camera sees the bounds {self.bounds.low} to {self.bounds.high}. "
                "Is this another data set's box, or are the matrices camera-to-world?"
            )

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

    def fingerprint(self) -> str:
        """Text that two scenes share only where views, silhouettes, bounds and unit are the same, to the last bit.

        Photographs and masks count by what they are made from: the bytes of a file, an array, or a recipe.
        """
        told = (*(view.fingerprint() for view in self.views), self.bounds, float(self.mm_per_unit))
        return hashlib.sha256(repr(told).encode()).hexdigest()

    @property
    def packed(self) -> PackedViews:
        """All views as arrays for kernels; made when first asked for."""
        return self.packed_at(1.0)

    def packed_at(self, scale: float) -> PackedViews:
        """All views at a scale of at most 1 as arrays for kernels; each scale's made once, when first asked for."""
        return self._packings.setdefault(scale, Once()).get(lambda: PackedViews(self.views, scale))

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n_views, 3) camera centres in the world."""
        return np.array([view.center for view in self.views])

    @property
    def pixel_footprint(self) -> float:
        """Median size of a pixel at the centre of the bounds, world units."""
        middle = self.bounds.center[None]
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
            "silhouettes": sum(view.has_silhouette for view in self.views),
            "bounds (mm)": " x ".join(f"{side:.1f}" for side in self.bounds.extent * self.mm_per_unit),
            "pixel footprint (mm)": f"{self.pixel_footprint * self.mm_per_unit:.3f}",
            **self.notes,
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB photographs, small; some evenly chosen ones of many views."""
        chosen = np.unique(np.linspace(0, len(self.views) - 1, min(_PICTURED, len(self.views))).round().astype(int))
        return thumbnails((self.views[n].image for n in chosen), width=120, columns=4)
