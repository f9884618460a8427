"""Silhouettes: which pixels may show the object."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, DataError
from recon3d.scene.background import BACKGROUND_LEVEL, foreground
from recon3d.scene.bounds import Bounds
from recon3d.scene.mask import ComputedMask, Mask
from recon3d.scene.mask_files import fitting_masks, masks_of_views
from recon3d.scene.names import file_stems
from recon3d.scene.regions import bounds_mask, disc, without_small_holes
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_NAMED = 6  # views, in a warning


def with_threshold_silhouettes(
    scene: Scene,
    *,
    level: float = BACKGROUND_LEVEL,
    dilate: int = 10,
    erode: int = 7,
    fill: int = 20,
    only: Collection[str] | None = None,
) -> Scene:
    """Scene with silhouettes made from a dark background, each when it is first asked for.

    Threshold, dilate, erode, as the README of Middlebury's dinoSparseRing says; small holes are filled, since dark
    shadows on an object leave them; then cut to the projected bounds, since a stand may be brighter than the
    threshold. Nothing is taken off at the image border: what lies beyond it is unknown, not empty.

    Parameters
    ----------
    level : fraction of white in (0, 1).
    dilate, erode : radii in pixels; their difference is the safety margin.
    fill : enclosed holes smaller than a disc of this radius in pixels belong to the object.
    only : names of the views to treat; the others get none. All when None.
    """
    if not 0 < level < 1:
        raise ArgumentError(f"expected a level between 0 and 1, got {level}")
    if min(dilate, erode, fill) < 0:
        raise ArgumentError(f"expected radii of 0 pixels or more, got dilate={dilate}, erode={erode}, fill={fill}")
    return with_masks(scene, lambda view: _Threshold(view, scene.bounds, level, dilate, erode, fill), only)


def with_masks(scene: Scene, mask: Callable[[View], Mask], only: Collection[str] | None) -> Scene:
    """Scene with a mask for each of the named views, or for all; made of the view without one."""
    bare = [replace(view, mask=None) for view in scene.views]
    views = (replace(view, mask=mask(view)) if only is None or view.name in only else view for view in bare)
    return replace(scene, views=tuple(views))


@dataclass(frozen=True, eq=False)
class _Threshold(ComputedMask):
    """The silhouette of a dark background: threshold, dilate, erode, fill, cut to the bounds."""

    view: View
    bounds: Bounds
    level: float
    dilate: int
    erode: int
    fill: int

    @property
    def size(self) -> tuple[int, int]:
        return self.view.width, self.view.height

    def compute(self) -> NDArray[np.bool_]:
        grown = cv2.dilate(foreground(self.view.image, self.level).astype(np.uint8), disc(self.dilate))
        # OpenCV's border value for erosion is the largest one, so a silhouette that leaves the image stays attached.
        closed = without_small_holes(cv2.erode(grown, disc(self.erode)) > 0, np.pi * self.fill**2)
        return closed & bounds_mask(self.bounds, self.view)

    def shrunk(self, scale: float) -> _Threshold:
        """The mask that is made of the photograph at a scale."""
        return replace(self, view=self.view.shrunk(scale))

    def fingerprint(self) -> str:
        parameters = (self.bounds, self.level, self.dilate, self.erode, self.fill)
        return f"threshold {parameters} {self.view.fingerprint()}"


def with_mask_files(scene: Scene, folder: Path | str, *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes read from image files named like the views, white for object; views without are named.

    For a view ``a/001.png`` that is ``a/001.*`` or ``a/001.png.*`` in the folder, the same with "mask" in it
    (``a/001.mask.*``), ``a_001.*``, the name that the view's own files are written under, or one of the same number.
    Masks of another size than the photograph are scaled.

    Parameters
    ----------
    only : names of the views that have one; the others get none. All when None.

    Raises
    ------
    DataError : no view has a mask, or one is unreadable or of another shape than its view's image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"{folder}: expected a folder of mask images")
    wanted = [view for view in scene.views if only is None or view.name in only]
    stems = file_stems(scene)
    files = masks_of_views(wanted, [stems[view.name] for view in wanted], folder)
    missing = [view.name for view in wanted if view.name not in files]
    if missing and not files:
        expected, held = Path(missing[0]).with_suffix(""), sorted(path.name for path in folder.iterdir())
        raise DataError(
            f"{folder}: expected one mask named {expected}.* for view {missing[0]}, found 0; "
            f"the folder holds {', '.join(held[:3]) + ' ...' * (len(held) > 3) or 'nothing'}"
        )
    if missing:
        warnings.warn(
            f"{folder}: {len(missing)} of {len(wanted)} views have no mask and exclude nothing: "
            f"{', '.join(missing[:_NAMED])}{' ...' * (len(missing) > _NAMED)}",
            stacklevel=3,
        )
    masks = fitting_masks(wanted, files)
    return replace(scene, views=tuple(replace(view, mask=masks.get(view.name)) for view in scene.views))


def without_silhouettes(scene: Scene) -> Scene:
    """Scene in which no silhouette is known."""
    return replace(scene, views=tuple(replace(view, mask=None) for view in scene.views))


def overlay(scene: Scene, view: View) -> NDArray[np.uint8]:
    """(height, width, 3) RGB photograph, blue where its silhouette excludes, the outline of the bounds in yellow."""
    picture = view.image.copy()
    silhouette = view.silhouette
    if silhouette is not None:
        picture[~silhouette] = picture[~silhouette] // 2 + np.array([0, 20, 90], np.uint8)
    edge = cv2.morphologyEx(bounds_mask(scene.bounds, view).astype(np.uint8), cv2.MORPH_GRADIENT, disc(1)) > 0
    picture[edge] = (255, 220, 0)
    return picture
