"""Matches between photographs that hold whatever the cameras say.

References
----------
D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 60(2), 2004.
C. Wu, "Towards linear-time incremental structure from motion", 3DV 2013 (preemptive matching).
D. Barath, J. Noskova, M. Ivashechkin, J. Matas, "MAGSAC++, a fast, reliable and accurate robust estimator", CVPR 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.camera import Camera
from recon3d.scene.mask import ComputedMask
from recon3d.scene.view import View

LONG_SIDE = 480
"""Pixels along the longer side of the reduced photographs."""

_FEATURES = 600
_COARSEST = 160  # features of the preemptive matching
_PARTNERS = 2  # by the cameras, and as many by the photographs
_RATIO = 0.8
_FEWEST, _AGREEING = 24, 0.5  # matches of a pair, and the share that agrees with one epipolar geometry
_KEPT = 60  # of a pair, evenly chosen
_RIM_SHARE, _MIDDLE_SHARE = 0.75, 0.25  # of the pixels at the border and in the middle, in inverted masks
_STILL = 1.5  # reduced pixels; what moves less belongs to a background that stands still before the camera


@dataclass(frozen=True)
class Picture:
    """A reduced photograph, its mask and its features."""

    view: View
    camera: Camera
    """Of the reduced photograph."""
    image: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    grey: NDArray[np.uint8]
    """(height, width)."""
    mask: NDArray[np.bool_] | None
    """(height, width), of a mask that is given; None: none is, or it would have to be computed."""
    places: NDArray[np.float64]
    """(n, 2) features, reduced pixels, the strongest first."""
    descriptors: NDArray[np.float32]
    """(n, 128) of unit length."""
    inverted: bool
    """Whether the mask that is given holds the image's border instead of its middle; then it is not used."""

    @classmethod
    def of(cls, view: View) -> Picture:
        """Reduce a view's photograph and find its features; inside its mask where one is given."""
        scale = min(1.0, LONG_SIDE / max(view.width, view.height))
        image = view.image_at(scale)
        given = view.mask is not None and not isinstance(view.mask, ComputedMask)
        mask = view.silhouette_at(scale) if given else None
        inverted = mask is not None and _is_inverted(mask)
        mask = None if inverted else mask
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
        within = None if mask is None else mask.astype(np.uint8)
        found, descriptors = cv2.SIFT.create(
            nfeatures=_FEATURES, contrastThreshold=0.02, enable_precise_upscale=True
        ).detectAndCompute(grey, within)
        descriptors = np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors, np.float32)
        order = np.argsort([-point.response for point in found], kind="stable")
        places = np.array([point.pt for point in found], np.float64).reshape(-1, 2)[order]
        descriptors = descriptors[order] / np.maximum(np.linalg.norm(descriptors[order], axis=1, keepdims=True), 1e-6)
        return cls(view, view.calibration.at(scale), image, grey, mask, places, descriptors, inverted)


@dataclass(frozen=True)
class Matches:
    """Trusted matches between pairs of pictures, one row a match."""

    pairs: NDArray[np.int64]
    """(n_pairs, 2) the pictures of each pair."""
    pair: NDArray[np.int64]
    """(n,) which pair a match is of, in ascending order."""
    places: NDArray[np.float64]
    """(n, 2, 2) its two places, reduced pixels."""

    @classmethod
    def between(cls, pictures: Sequence[Picture]) -> Matches:
        """Match each picture with its neighbours by the cameras, and with those that look most alike."""
        pairs: list[tuple[int, int]] = []
        rows, places = [], []
        for a, b in sorted(_chosen_pairs(pictures)):
            found = _trusted(pictures[a], pictures[b])
            if found is not None:
                rows.append(np.full(len(found), len(pairs)))
                places.append(found)
                pairs.append((a, b))
        return cls(
            np.array(pairs, np.int64).reshape(-1, 2),
            np.concatenate(rows).astype(np.int64) if rows else np.zeros(0, np.int64),
            np.concatenate(places) if places else np.zeros((0, 2, 2)),
        )


def _chosen_pairs(pictures: Sequence[Picture]) -> set[tuple[int, int]]:
    """Pairs (a, b), a < b, that are worth matching."""
    n = len(pictures)
    alike = np.zeros((n, n))
    coarse = [picture.descriptors[:_COARSEST] for picture in pictures]
    starts = np.cumsum([0, *map(len, coarse)])
    for a in range(n - 1):
        cosines = coarse[a] @ np.concatenate(coarse[a + 1 :]).T  # one product: short ones cost more than they compute
        for b in range(a + 1, n):
            columns = slice(starts[b] - starts[a + 1], starts[b + 1] - starts[a + 1])
            alike[a, b] = alike[b, a] = len(_mutual(cosines[:, columns]))
    centers = np.array([picture.view.center for picture in pictures])
    axes = np.array([picture.view.cam_from_world[2, :3] for picture in pictures])
    spread = max(float(np.median(np.linalg.norm(centers - np.median(centers, axis=0), axis=1))), 1e-12)
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2) / spread + 1.0 - axes @ axes.T
    np.fill_diagonal(apart, np.inf)
    np.fill_diagonal(alike, -1)
    chosen = set()
    for a in range(n):
        for b in (*np.argsort(apart[a], kind="stable")[:_PARTNERS], *np.argsort(-alike[a], kind="stable")[:_PARTNERS]):
            if a != b:
                chosen.add((min(a, int(b)), max(a, int(b))))
    return chosen


def _mutual(cosines: NDArray[np.float32]) -> NDArray[np.int64]:
    """(n, 2) rows and columns that are each other's nearest and clearly nearer than the second (ratio test).

    Parameters
    ----------
    cosines : (n_a, n_b) between descriptors.
    """
    if min(cosines.shape) < 2:
        return np.zeros((0, 2), np.int64)
    best = cosines.argmax(axis=1)
    rows = np.arange(len(cosines))
    highest = cosines[rows, best]
    mutual = cosines.argmax(axis=0)[best] == rows
    others = cosines.copy()
    others[rows, best] = -1
    second = others.max(axis=1)
    clear = (1 - highest) < _RATIO**2 * (1 - second)  # squared distances of unit vectors are 2 - 2 cosines
    kept = rows[mutual & clear]
    return np.column_stack([kept, best[kept]]).astype(np.int64)


def _trusted(a: Picture, b: Picture) -> NDArray[np.float64] | None:
    """(n, 2, 2) matches of two pictures that agree with an epipolar geometry of their own; None: too few."""
    found = _mutual(a.descriptors @ b.descriptors.T)
    places = np.stack([a.places[found[:, 0]], b.places[found[:, 1]]], axis=1)
    places = places[np.linalg.norm(places[:, 0] - places[:, 1], axis=1) > _STILL]
    if len(places) < _FEWEST:
        return None
    _, inliers = cv2.findFundamentalMat(places[:, 0], places[:, 1], cv2.USAC_MAGSAC, 1.0, 0.999, 2000)
    if inliers is None:
        return None
    kept = places[np.asarray(inliers).ravel() > 0]
    if len(kept) < max(_FEWEST, _AGREEING * len(places)):
        return None
    return np.asarray(kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), _KEPT)).round().astype(int))])


def _is_inverted(mask: NDArray[np.bool_]) -> bool:
    """Whether a mask (height, width) holds most of the image's border and little of its middle."""
    height, width = mask.shape
    rim = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    middle = mask[2 * height // 5 : 3 * height // 5 + 1, 2 * width // 5 : 3 * width // 5 + 1]
    return bool(rim.mean() >= _RIM_SHARE and middle.mean() <= _MIDDLE_SHARE)
