"""Silhouettes: which pixels may show the object."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from os import cpu_count
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, DataError
from recon3d.scene.bounds import Bounds
from recon3d.scene.mask import ComputedMask, Mask
from recon3d.scene.mask_files import fitting_masks, masks_of_views
from recon3d.scene.names import file_stems
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.values import ByContent, Once

_FAR = 1e6  # pixels; a corner nearly beside the camera, too far out for OpenCV to draw


_NAMED = 6  # views, in a warning


_RIM = 3  # pixels at the object's edge that may be either


_HOLE = 10  # enclosed holes smaller than a disc of this radius in pixels are shadows


BACKGROUND_LEVEL = 0.19
"""Fraction of white below which a pixel is dark background (the Middlebury dinoSparseRing recipe)."""


_FRAME = 0.02  # of the shorter side: width of an image's frame


_PLAIN = 8  # grey levels between half of the frame and its median color: more than noise and soft light make


BLACK = (0, 0, 0)


def foreground(
    image: NDArray[np.uint8], level: float = BACKGROUND_LEVEL, color: tuple[int, int, int] = BLACK
) -> NDArray[np.bool_]:
    """(height, width) pixels of an RGB image that differ from a background's color by more than a fraction of white."""
    return difference(image, color) > level * 255


def difference(image: NDArray[np.uint8], color: tuple[int, int, int] = BLACK) -> NDArray[np.uint8]:
    """(height, width) largest difference of an RGB image's channels from a color; from black, the brightest channel."""
    red, green, blue = cv2.split(image if color == BLACK else cv2.absdiff(image, np.array(color, np.float64)))
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def has_plain_frame(image: NDArray[np.uint8]) -> bool:
    """Whether the frame of an RGB image (height, width, 3) is of about one color, as before a backdrop."""
    width = max(1, round(_FRAME * min(image.shape[:2])))
    inner = np.zeros(image.shape[:2], np.bool_)
    inner[width:-width, width:-width] = True
    frame = image[~inner].astype(np.int64)
    return bool(np.median(np.abs(frame - np.median(frame, axis=0)).max(axis=1)) <= _PLAIN)


def background_color(views: Iterable[View], bounds: Bounds) -> tuple[int, int, int]:
    """Median color, RGB, of what views show outside the projected bounds; black where it is dark, or all are full."""
    return _median_color(np.sum([_histograms(view, bounds)[1:] for view in views], axis=0))


def _histograms(view: View, bounds: Bounds) -> NDArray[np.int64]:
    """(4, 256) numbers of pixels outside the projected bounds, by their brightest channel, and by red, green, blue."""
    image, outside = view.image, np.asarray(~bounds_mask(bounds, view), np.uint8)
    pictures = (difference(image), *cv2.split(image))
    return np.array([cv2.calcHist([each], [0], outside, [256], [0, 256]).ravel() for each in pictures]).astype(np.int64)


def _median_color(counts: NDArray[np.int64]) -> tuple[int, int, int]:
    """Color of (3, 256) numbers of pixels by channel."""
    n = int(counts[0].sum())
    red, green, blue = (int(np.searchsorted(channel.cumsum(), n / 2)) for channel in counts)
    return (red, green, blue) if n and max(red, green, blue) > BACKGROUND_LEVEL * 255 else BLACK


def bounds_mask(bounds: Bounds, view: View) -> NDArray[np.bool_]:
    """Pixels (height, width) that a box can project to; all where a corner is behind the camera."""
    pixels, depth = view.project(bounds.corners)
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
    return _with_masks(scene, lambda view: _Threshold(view, scene.bounds, level, dilate, erode, fill), only)


def with_segmented_silhouettes(scene: Scene, *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes cut out along the strongest edges, for an object before a background of one color.

    Pixels outside the projected bounds are background for certain; their median color is the background's, or black
    where that is dark. Pixels that differ from it by more than nearly all of those, of all views, are object but for a
    rim, whose fate GrabCut decides by color and contrast; so dark shadows on the object stay in it, and the outline is
    exact to about half a pixel. Each is made when it is first asked for.

    Parameters
    ----------
    only : names of the views to treat; the others get none. All when None.

    References
    ----------
    Rother, Kolmogorov, Blake, "GrabCut: interactive foreground extraction using iterated graph cuts", SIGGRAPH 2004.
    """
    background = _Background(tuple(replace(view, mask=None) for view in scene.views), scene.bounds)
    return _with_masks(scene, lambda view: _Segmented(view, background), only)


def _with_masks(scene: Scene, mask: Callable[[View], Mask], only: Collection[str] | None) -> Scene:
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

    def shrunk(self, scale: float) -> _Threshold:
        """The mask that is made of the photograph at a scale."""
        return replace(self, view=self.view.shrunk(scale))

    def compute(self) -> NDArray[np.bool_]:
        grown = cv2.dilate(foreground(self.view.image, self.level).astype(np.uint8), _disc(self.dilate))
        # OpenCV's border value for erosion is the largest one, so a silhouette that leaves the image stays attached.
        closed = _without_small_holes(cv2.erode(grown, _disc(self.erode)) > 0, np.pi * self.fill**2)
        return closed & bounds_mask(self.bounds, self.view)

    def fingerprint(self) -> str:
        parameters = (self.bounds, self.level, self.dilate, self.erode, self.fill)
        return f"threshold {parameters} {self.view.fingerprint()}"


@dataclass(frozen=True, eq=False)
class _Background(ByContent):
    """What the views show outside the projected bounds."""

    views: tuple[View, ...]
    bounds: Bounds
    _found: Once[tuple[tuple[int, int, int], float]] = field(
        default_factory=Once, init=False, repr=False, compare=False
    )
    _fingerprint: Once[str] = field(default_factory=Once, init=False, repr=False, compare=False)
    _shrunk: dict[float, Once[_Background]] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __hash__(self) -> int:
        return hash((len(self.views), self.bounds))  # every view's mask asks for it

    @property
    def color(self) -> tuple[int, int, int]:
        """Its color, RGB."""
        return self._found.get(self._find)[0]

    @property
    def level(self) -> float:
        """Fraction of white that 99% of its pixels do not differ by from the color."""
        return self._found.get(self._find)[1]

    def shrunk(self, scale: float) -> _Background:
        """That of the views at a scale; one for all views' masks."""
        made = self._shrunk.setdefault(scale, Once())
        return made.get(lambda: _Background(tuple(view.shrunk(scale) for view in self.views), self.bounds))

    def _find(self) -> tuple[tuple[int, int, int], float]:
        with ThreadPoolExecutor(cpu_count()) as pool:  # OpenCV and numpy release the interpreter lock
            by_channel = np.sum(list(pool.map(lambda view: _histograms(view, self.bounds), self.views)), axis=0)
            color, counts = _median_color(by_channel[1:]), by_channel[0]
            if color != BLACK:
                counts = np.sum(list(pool.map(lambda view: self._histogram(view, color), self.views)), axis=0)
        n = int(counts.sum())
        if n == 0:
            return color, BACKGROUND_LEVEL
        # Linear between the two pixels, in order of brightness, that the percentile lies between.
        place = 0.99 * (n - 1)
        below, above = np.searchsorted(counts.cumsum(), [np.floor(place), np.ceil(place)], side="right")
        return color, float(below + (above - below) * (place % 1)) / 255

    def _histogram(self, view: View, color: tuple[int, int, int]) -> NDArray[np.int64]:
        """(256,) number of background pixels of each difference from a color."""
        return np.bincount(difference(view.image, color)[~bounds_mask(self.bounds, view)], minlength=256)

    def fingerprint(self) -> str:
        """Text that tells the bounds and all photographs."""

        def digest() -> str:
            told = repr((self.bounds, [view.fingerprint() for view in self.views]))
            return hashlib.sha256(told.encode()).hexdigest()

        return self._fingerprint.get(digest)


@dataclass(frozen=True, eq=False)
class _Segmented(ComputedMask):
    """The silhouette that GrabCut finds."""

    view: View
    background: _Background

    @property
    def size(self) -> tuple[int, int]:
        return self.view.width, self.view.height

    def shrunk(self, scale: float) -> _Segmented:
        """The mask that is made of the photographs at a scale."""
        return _Segmented(self.view.shrunk(scale), self.background.shrunk(scale))

    def compute(self) -> NDArray[np.bool_]:
        level, color = self.background.level, self.background.color
        return _grab_cut(self.view, level, color, bounds_mask(self.background.bounds, self.view))

    def fingerprint(self) -> str:
        return f"segmented {self.view.name} {self.background.fingerprint()}"


def _grab_cut(view: View, level: float, color: tuple[int, int, int], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Object pixels of a view: those surely off the color, inside a mask, and what GrabCut adds at the rim."""
    picture = view.image
    likely = foreground(picture, level, color) & within
    labels = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.erode(likely.astype(np.uint8), _disc(_RIM)) > 0] = cv2.GC_FGD
    labels[~within] = cv2.GC_BGD
    if not (labels == cv2.GC_FGD).any() or not (labels != cv2.GC_FGD).any():
        return likely  # nothing to learn the object or the background from
    left, top, width, height = cv2.boundingRect(cv2.dilate(within.astype(np.uint8), _disc(_RIM)))
    cut = np.s_[top : top + height, left : left + width]
    part = np.ascontiguousarray(labels[cut])
    object_model, background_model = np.zeros((1, 65)), np.zeros((1, 65))
    image = np.ascontiguousarray(picture[cut])
    cv2.setRNGSeed(0)  # of this thread; GrabCut starts its clusters at random
    cv2.grabCut(image, part, (0, 0, 0, 0), background_model, object_model, 2, cv2.GC_INIT_WITH_MASK)
    mask = np.zeros_like(within)
    mask[cut] = (part == cv2.GC_FGD) | (part == cv2.GC_PR_FGD)
    return _without_small_holes(mask, np.pi * _HOLE**2)


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
    edge = cv2.morphologyEx(bounds_mask(scene.bounds, view).astype(np.uint8), cv2.MORPH_GRADIENT, _disc(1)) > 0
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
