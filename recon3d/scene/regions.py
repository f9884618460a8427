"""Regions of an image: discs, enclosed holes, what a box projects to."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.view import View

_FAR = 1e6  # pixels; a corner nearly beside the camera, too far out for OpenCV to draw


def bounds_mask(bounds: Bounds, view: View) -> NDArray[np.bool_]:
    """Pixels (height, width) that a box can project to; all where a corner is behind the camera."""
    pixels, depth = view.project(bounds.corners)
    if (depth <= 0).any() or np.abs(pixels).max() > _FAR:
        return np.ones((view.height, view.width), np.bool_)
    mask = np.zeros((view.height, view.width), np.uint8)
    outline = cv2.convexHull(pixels.astype(np.float32)).round().astype(np.int32)
    cv2.fillConvexPoly(mask, outline, 1)
    return cv2.dilate(mask, disc(1)) > 0  # rounding the corners may have cut up to a pixel off


def without_small_holes(mask: NDArray[np.bool_], area: float) -> NDArray[np.bool_]:
    """(height, width) a mask, enclosed holes below an area in pixels filled; at the border they may go on outside."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    left, top, width, height, size = stats[:, : cv2.CC_STAT_AREA + 1].T
    inside = (left > 0) & (top > 0) & (left + width < mask.shape[1]) & (top + height < mask.shape[0])
    small = inside & (size < area)
    small[0] = False  # the mask itself
    return np.asarray(mask | small[labels])


def disc(radius: int) -> NDArray[np.uint8]:
    """(n, n) round structuring element of 2 radius + 1 pixels, 0 or 1."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)
