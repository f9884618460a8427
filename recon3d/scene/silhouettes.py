"""Silhouettes: which pixels may show the object."""

from __future__ import annotations

from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_FAR = 1e6  # pixels; a corner nearly beside the camera, too far out for OpenCV to draw


_RIM = 3  # pixels at the object's edge that may be either


_HOLE = 10  # enclosed holes smaller than a disc of this radius in pixels are shadows


BACKGROUND_LEVEL = 0.19
"""Fraction of white below which a pixel is dark background (the Middlebury dinoSparseRing recipe)."""


def foreground(image: NDArray[np.uint8], level: float = BACKGROUND_LEVEL) -> NDArray[np.bool_]:
    """Pixels of an RGB image whose brightest channel is above a fraction of white."""
    return np.asarray(image.max(axis=2) > level * 255)


def bounds_mask(scene: Scene, view: View) -> NDArray[np.bool_]:
    """Pixels (height, width) that the scene's bounds can project to; all where a corner is behind the camera."""
    pixels, depth = view.project(scene.bounds.corners)
    if (depth <= 0).any() or np.abs(pixels).max() > _FAR:
        return np.ones((view.height, view.width), np.bool_)
    mask = np.zeros((view.height, view.width), np.uint8)
    outline = cv2.convexHull(pixels.astype(np.float32)).round().astype(np.int32)
    cv2.fillConvexPoly(mask, outline, 1)
    return cv2.dilate(mask, _disc(1)) > 0  # rounding the corners may have cut up to a pixel off


def with_threshold_silhouettes(
    scene: Scene,
    *,
    level: float = BACKGROUND_LEVEL,
    dilate: int = 10,
    erode: int = 7,
    fill: int = 20,
    only: Collection[str] | None = None,
) -> Scene:
    """Scene with silhouettes made from a dark background.

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
        raise ValueError(f"expected a level between 0 and 1, got {level}")
    if min(dilate, erode, fill) < 0:
        raise ValueError(f"expected radii of 0 pixels or more, got dilate={dilate}, erode={erode}, fill={fill}")

    def silhouette(view: View) -> NDArray[np.bool_]:
        grown = cv2.dilate(foreground(view.image, level).astype(np.uint8), _disc(dilate))
        # OpenCV's border value for erosion is the largest one, so a silhouette that leaves the image stays attached.
        closed = _without_small_holes(cv2.erode(grown, _disc(erode)) > 0, np.pi * fill**2)
        return closed & bounds_mask(scene, view)

    return replace(
        scene,
        views=tuple(
            replace(view, silhouette=silhouette(view) if only is None or view.name in only else None)
            for view in scene.views
        ),
    )


def with_segmented_silhouettes(scene: Scene, *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes cut out along the strongest edges, for an object before a darker background.

    Pixels outside the projected bounds are background for certain. Pixels brighter than nearly all of those are
    object but for a rim, whose fate GrabCut decides by colour and contrast; so dark shadows on the object stay in it,
    and the outline is exact to about half a pixel.

    Parameters
    ----------
    only : names of the views to treat; the others get none. All when None.

    References
    ----------
    Rother, Kolmogorov, Blake, "GrabCut: interactive foreground extraction using iterated graph cuts", SIGGRAPH 2004.
    """
    outside = [view.image[~bounds_mask(scene, view)].max(axis=1) for view in scene.views]
    beyond = np.concatenate(outside)
    level = float(np.percentile(beyond, 99)) / 255 if beyond.size else BACKGROUND_LEVEL

    def silhouette(view: View) -> NDArray[np.bool_] | None:
        if only is not None and view.name not in only:
            return None
        return _grab_cut(view, level, bounds_mask(scene, view))

    with ThreadPoolExecutor() as pool:  # OpenCV releases the interpreter lock
        silhouettes = list(pool.map(silhouette, scene.views))
    return replace(
        scene,
        views=tuple(replace(view, silhouette=mask) for view, mask in zip(scene.views, silhouettes, strict=True)),
    )


def _grab_cut(view: View, level: float, within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Object pixels of a view: those surely above the level, inside a mask, and what GrabCut adds at the rim."""
    likely = foreground(view.image, level) & within
    labels = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.erode(likely.astype(np.uint8), _disc(_RIM)) > 0] = cv2.GC_FGD
    labels[~within] = cv2.GC_BGD
    if not (labels == cv2.GC_FGD).any() or not (labels != cv2.GC_FGD).any():
        return likely  # nothing to learn the object or the background from
    left, top, width, height = cv2.boundingRect(cv2.dilate(within.astype(np.uint8), _disc(_RIM)))
    cut = np.s_[top : top + height, left : left + width]
    part = np.ascontiguousarray(labels[cut])
    object_model, background_model = np.zeros((1, 65)), np.zeros((1, 65))
    image = np.ascontiguousarray(view.image[cut])
    cv2.setRNGSeed(0)  # of this thread; GrabCut starts its clusters at random
    cv2.grabCut(image, part, (0, 0, 0, 0), background_model, object_model, 2, cv2.GC_INIT_WITH_MASK)
    mask = np.zeros_like(within)
    mask[cut] = (part == cv2.GC_FGD) | (part == cv2.GC_PR_FGD)
    return _without_small_holes(mask, np.pi * _HOLE**2)


def with_mask_files(scene: Scene, folder: Path | str, *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes read from ``folder/<view name>``, white for object, any extension, one for each view.

    Parameters
    ----------
    only : names of the views that have one; the others get none. All when None.

    Raises
    ------
    DataError : a mask is missing, unreadable or of another size than its view's image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise DataError(f"{folder}: expected a folder of mask images")

    def silhouette(view: View) -> NDArray[np.bool_]:
        stem = Path(view.name).stem
        found = sorted(path for path in folder.iterdir() if path.stem == stem)
        if len(found) != 1:
            raise DataError(f"{folder}: expected one mask named {stem}.* for view {view.name}, found {len(found)}")
        mask = cv2.imread(str(found[0]), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise DataError(f"{found[0]}: not a readable image")
        if mask.shape != (view.height, view.width):
            raise DataError(
                f"{found[0]}: expected {view.width}x{view.height} pixels like view {view.name}, "
                f"got {mask.shape[1]}x{mask.shape[0]}"
            )
        return np.asarray(mask > 127)

    return replace(
        scene,
        views=tuple(
            replace(view, silhouette=silhouette(view) if only is None or view.name in only else None)
            for view in scene.views
        ),
    )


def without_silhouettes(scene: Scene) -> Scene:
    """Scene in which no silhouette is known."""
    return replace(scene, views=tuple(replace(view, silhouette=None) for view in scene.views))


def overlay(scene: Scene, view: View) -> NDArray[np.uint8]:
    """RGB photograph with what its silhouette excludes tinted blue and the outline of the bounds in yellow."""
    picture = view.image.copy()
    if view.silhouette is not None:
        picture[~view.silhouette] = picture[~view.silhouette] // 2 + np.array([0, 20, 90], np.uint8)
    edge = cv2.morphologyEx(bounds_mask(scene, view).astype(np.uint8), cv2.MORPH_GRADIENT, _disc(1)) > 0
    picture[edge] = (255, 220, 0)
    return picture


def _without_small_holes(mask: NDArray[np.bool_], area: float) -> NDArray[np.bool_]:
    """The mask with its enclosed holes below an area in pixels filled; one at the image border may go on outside."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    left, top, width, height, size = stats[:, : cv2.CC_STAT_AREA + 1].T
    inside = (left > 0) & (top > 0) & (left + width < mask.shape[1]) & (top + height < mask.shape[0])
    small = inside & (size < area)
    small[0] = False  # the mask itself
    return np.asarray(mask | small[labels])


def _disc(radius: int) -> NDArray[np.uint8]:
    """Round structuring element."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)
