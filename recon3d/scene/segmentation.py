"""Silhouettes cut out of a background of one color by GrabCut, and checked against each other."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Collection, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from os import cpu_count

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import SceneWarning
from recon3d.scene.background import Background, foreground
from recon3d.scene.mask import ArrayMask, ComputedMask
from recon3d.scene.mask_holes import FEWEST_MASKS, contradicted_holes
from recon3d.scene.regions import bounds_mask, disc, without_small_holes
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import with_masks
from recon3d.scene.view import View
from recon3d.values import ByContent, Once

_RIM = 3  # pixels at the object's edge that may be either
_HOLE = 10  # enclosed holes smaller than a disc of this radius in pixels are shadows


def with_segmented_silhouettes(scene: Scene, *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes cut out along the strongest edges, for an object before a background of one color.

    Pixels outside the projected bounds are background for certain; their median color is the background's, or black
    where that is dark. Pixels that differ from it by more than nearly all of those, of all views, are object but for a
    rim, whose fate GrabCut decides by color and contrast; so dark shadows on the object stay in it, and the outline is
    exact to about half a pixel. Holes that all other silhouettes and the colors there contradict are mended, with a
    warning. Each is made when it is first asked for; four or more need all others.

    Parameters
    ----------
    only : names of the views to treat; the others get none. All when None.

    References
    ----------
    Rother, Kolmogorov, Blake, "GrabCut: interactive foreground extraction using iterated graph cuts", SIGGRAPH 2004.
    """
    background = Background(tuple(replace(view, mask=None) for view in scene.views), scene.bounds)
    segmented = with_masks(scene, lambda view: _Segmented(view, background), only)
    masked = tuple(view for view in segmented.views if view.has_silhouette)
    if len(masked) < FEWEST_MASKS:
        return segmented
    together = _Together(scene.name, masked, background)
    return with_masks(scene, lambda view: _Mended(view, together), [view.name for view in masked])


def filled_holes(views: Iterable[View], scale: float) -> list[str]:
    """Names of the views in whose segmented silhouettes holes are filled, without a warning.

    Parameters
    ----------
    scale : of the photographs, at most 1, at which silhouettes are made where they are not there in full size.
    """
    together = next((view.mask.together for view in views if isinstance(view.mask, _Mended)), None)
    if together is None:
        return []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneWarning)
        return list((together if together.is_checked or scale == 1 else together.shrunk(scale)).holes)


@dataclass(frozen=True, eq=False)
class _Segmented(ComputedMask):
    """The silhouette that GrabCut finds."""

    view: View
    background: Background

    @property
    def size(self) -> tuple[int, int]:
        return self.view.width, self.view.height

    def compute(self) -> NDArray[np.bool_]:
        level, color = self.background.level, self.background.color
        return _grab_cut(self.view, level, color, bounds_mask(self.background.bounds, self.view))

    def shrunk(self, scale: float) -> _Segmented:
        """The mask that is made of the photographs at a scale."""
        return _Segmented(self.view.shrunk(scale), self.background.shrunk(scale))

    def fingerprint(self) -> str:
        return f"segmented {self.view.name} {self.background.fingerprint()}"


@dataclass(frozen=True, eq=False)
class _Together(ByContent):
    """Silhouettes that are checked against each other."""

    name: str
    """Of the scene."""
    views: tuple[View, ...]
    """With segmented silhouettes."""
    background: Background
    _holes: Once[dict[str, ArrayMask]] = field(default_factory=Once, init=False, repr=False, compare=False)
    _shrunk: dict[float, Once[_Together]] = field(default_factory=dict, init=False, repr=False, compare=False)
    _fingerprint: Once[str] = field(default_factory=Once, init=False, repr=False, compare=False)

    def __hash__(self) -> int:
        return hash((self.name, len(self.views)))  # every view's mask asks for it

    @property
    def is_checked(self) -> bool:
        """Whether the silhouettes are made and were compared."""
        return self._holes.is_made

    @property
    def holes(self) -> dict[str, ArrayMask]:
        """Those that are filled, by the views' names."""
        return self._holes.get(self._find)

    def mended(self, name: str) -> NDArray[np.bool_]:
        """(height, width) the silhouette of a view, without holes that the others contradict."""
        hole = self.holes.get(name)
        (mask,) = (view.silhouette for view in self.views if view.name == name)
        if mask is None or hole is None:
            return np.asarray(mask)
        return mask | hole.unpacked()

    def _find(self) -> dict[str, ArrayMask]:
        with ThreadPoolExecutor(cpu_count()) as pool:  # OpenCV releases the interpreter lock
            list(pool.map(lambda view: view.silhouette, self.views))
        found = contradicted_holes(self.views, self.background.bounds, self.background.color)
        if found:
            told = ", ".join(f"{self.views[n].name} ({int(hole.sum())} pixels)" for n, hole in found.items())
            message = f"{self.name}: holes in silhouettes that all others and the colors contradict were filled: {told}"
            warnings.warn(SceneWarning(message, "masks"), stacklevel=2)
        return {self.views[n].name: ArrayMask(hole) for n, hole in found.items()}

    def shrunk(self, scale: float) -> _Together:
        """Those of the views at a scale; one for all views' masks."""

        def smaller() -> _Together:
            views = tuple(view.shrunk(scale) for view in self.views)
            return _Together(self.name, views, self.background.shrunk(scale))

        return self._shrunk.setdefault(scale, Once()).get(smaller)

    def fingerprint(self) -> str:
        """Text that tells all silhouettes."""

        def digest() -> str:
            names = [view.name for view in self.views]
            return hashlib.sha256(repr((names, self.background.fingerprint())).encode()).hexdigest()

        return self._fingerprint.get(digest)


@dataclass(frozen=True, eq=False)
class _Mended(ComputedMask):
    """A segmented silhouette that was checked against the others."""

    view: View
    together: _Together

    @property
    def size(self) -> tuple[int, int]:
        return self.view.width, self.view.height

    def compute(self) -> NDArray[np.bool_]:
        return self.together.mended(self.view.name)

    def shrunk(self, scale: float) -> _Mended:
        """The mask that is made of the photographs at a scale."""
        return _Mended(self.view.shrunk(scale), self.together.shrunk(scale))

    def fingerprint(self) -> str:
        return f"segmented, mended {self.view.name} {self.together.fingerprint()}"


def _grab_cut(view: View, level: float, color: tuple[int, int, int], within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Object pixels of a view: those surely off the color, inside a mask, and what GrabCut adds at the rim."""
    picture = view.image
    likely = foreground(picture, level, color) & within
    labels = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[cv2.erode(likely.astype(np.uint8), disc(_RIM)) > 0] = cv2.GC_FGD
    labels[~within] = cv2.GC_BGD
    if not (labels == cv2.GC_FGD).any() or not (labels != cv2.GC_FGD).any():
        return likely  # nothing to learn the object or the background from
    left, top, width, height = cv2.boundingRect(cv2.dilate(within.astype(np.uint8), disc(_RIM)))
    cut = np.s_[top : top + height, left : left + width]
    part = np.ascontiguousarray(labels[cut])
    object_model, background_model = np.zeros((1, 65)), np.zeros((1, 65))
    image = np.ascontiguousarray(picture[cut])
    cv2.setRNGSeed(0)  # of this thread; GrabCut starts its clusters at random
    cv2.grabCut(image, part, (0, 0, 0, 0), background_model, object_model, 2, cv2.GC_INIT_WITH_MASK)
    mask = np.zeros_like(within)
    mask[cut] = (part == cv2.GC_FGD) | (part == cv2.GC_PR_FGD)
    return without_small_holes(mask, np.pi * _HOLE**2)
