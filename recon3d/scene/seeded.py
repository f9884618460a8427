"""Silhouettes cut out of a background of many colors by GrabCut, where sparse points of the object are known."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.scene.bounds import Bounds
from recon3d.scene.mask import ComputedMask
from recon3d.scene.photograph import array_fingerprint
from recon3d.scene.regions import bounds_mask, disc, without_small_holes
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import with_masks
from recon3d.scene.view import View

FEWEST_SEEDS = 100
"""Points inside the bounds that silhouettes can be cut out around."""

_NEIGHBOUR = 3  # whose distance says how close points lie
_ALONE = 4.0  # times the usual distance of neighbours: a point that far from its own is none of the object
_SPACINGS = 2  # distances of neighbours in the photograph that a gap between points is wide, by half
_SMALLEST, _LARGEST = 3, 12  # pixels, the same
_CLOSED, _FAR = 3, 4  # times as much: gaps that are object, and what is background for certain
_HOLE = 10  # enclosed holes smaller than a disc of this radius in pixels are shadows
_ROUNDS = 4


def seeds_of(points: NDArray[np.float64], bounds: Bounds) -> NDArray[np.float64]:
    """Those of points (n, 3), world, that are inside bounds and close to others."""
    inside = points[((points > bounds.low) & (points < bounds.high)).all(axis=1)]
    if len(inside) < FEWEST_SEEDS:
        return inside
    apart = cKDTree(inside).query(inside, k=_NEIGHBOUR + 1)[0][:, -1]
    return np.asarray(inside[apart <= _ALONE * np.median(apart)])


def with_seeded_silhouettes(scene: Scene, seeds: NDArray[np.float64], *, only: Collection[str] | None = None) -> Scene:
    """Scene with silhouettes cut out around sparse points of the object, for a background of many colors.

    What the photographs show at the points is object, what is far from all of them or outside the projected bounds is
    background; GrabCut decides the rest by color and contrast. Shadows at the object's foot may be taken for object,
    and parts without points for background. Each is made when it is first asked for.

    Parameters
    ----------
    seeds : (n, 3) points of the object, world; see ``seeds_of``.
    only : names of the views to treat; the others get none. All when None.

    References
    ----------
    Rother, Kolmogorov, Blake, "GrabCut: interactive foreground extraction using iterated graph cuts", SIGGRAPH 2004.
    """
    return with_masks(scene, lambda view: _Seeded(view, scene.bounds, seeds), only)


@dataclass(frozen=True, eq=False)
class _Seeded(ComputedMask):
    """The silhouette that GrabCut finds around points."""

    view: View
    bounds: Bounds
    seeds: NDArray[np.float64]
    """(n, 3), world."""

    @property
    def size(self) -> tuple[int, int]:
        return self.view.width, self.view.height

    def compute(self) -> NDArray[np.bool_]:
        view, within = self.view, bounds_mask(self.bounds, self.view)
        pixels = view.project(self.seeds[view.sees(self.seeds)])[0]
        if len(pixels) <= _NEIGHBOUR:
            return within
        sure = np.zeros((view.height, view.width), np.uint8)
        u, v = np.rint(pixels).astype(np.int64).clip(0, [view.width - 1, view.height - 1]).T
        sure[v, u] = 1
        spacing = float(np.median(cKDTree(pixels).query(pixels, k=_NEIGHBOUR + 1)[0][:, -1]))
        reach = int(np.clip(round(_SPACINGS * spacing), _SMALLEST, _LARGEST))
        closed = cv2.morphologyEx(cv2.dilate(sure, disc(2)), cv2.MORPH_CLOSE, disc(_CLOSED * reach))
        likely = cv2.dilate(closed, disc(reach))
        labels = np.where(likely > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        labels[cv2.dilate(sure, disc(1)) > 0] = cv2.GC_FGD
        labels[(cv2.dilate(likely, disc(_FAR * reach)) == 0) | ~within] = cv2.GC_BGD
        if not (labels == cv2.GC_BGD).any() or not (labels == cv2.GC_FGD).any():
            return within  # nothing to learn the background from
        object_model, background_model = np.zeros((1, 65)), np.zeros((1, 65))
        image = np.ascontiguousarray(view.image)
        cv2.setRNGSeed(0)  # of this thread; GrabCut starts its clusters at random
        cv2.grabCut(image, labels, (0, 0, 0, 0), background_model, object_model, _ROUNDS, cv2.GC_INIT_WITH_MASK)
        mask = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
        return without_small_holes(mask, np.pi * _HOLE**2)

    def shrunk(self, scale: float) -> _Seeded:
        """The mask that is made of the photograph at a scale."""
        return _Seeded(self.view.shrunk(scale), self.bounds, self.seeds)

    def fingerprint(self) -> str:
        return f"seeded {self.bounds} {array_fingerprint(self.seeds)} {self.view.fingerprint()}"
