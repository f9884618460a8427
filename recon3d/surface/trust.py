"""Which of a view's pixels show the surface alone."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.rendering.ray_caster import RayCaster
from recon3d.rendering.renderer import bands, pixel_rays
from recon3d.scene.packed import pack_cameras
from recon3d.scene.view import View

_JUMP = 5.0  # pixel footprints of depth between neighbouring pixels that make an edge

EDGE_WEIGHT = 0.05
"""Of a pixel at an edge: it counts where nothing better is there."""


@dataclass(frozen=True, eq=False)
class TrustedPixels:
    """How far a view's pixels can be trusted, and what they show."""

    trust: NDArray[np.float32]
    """(height, width) 0 in and beside the background, ``EDGE_WEIGHT`` beside a jump of depth, else 1."""
    inverse_depth: NDArray[np.float32]
    """(height, width) of the surface, 1 / world units; 0 beside it."""


def trusted_pixels(caster: RayCaster, view: View) -> TrustedPixels:
    """Trust in the pixels of a view by its silhouette and a mesh's depths, since what lies behind bleeds in at edges.

    Inverse depth is linear in the pixels of a plane, however steep, so its second difference tells jumps from slopes.
    """
    window = np.ones((3, 3), np.uint8)
    focal = pack_cameras([view.calibration]).focals[0]
    rays = (pixel_rays(view.K, view.cam_from_world, view.width, rows) for rows in bands(view.height, view.width))
    inverse = 1 / np.concatenate([caster.first_hits(*each).distance for each in rays]).astype(np.float64)
    bend = np.zeros_like(inverse)
    bend[:, 1:-1] = np.abs(np.diff(inverse, 2, axis=1))
    bend[1:-1] = np.maximum(bend[1:-1], np.abs(np.diff(inverse, 2, axis=0)))
    edge = bend > _JUMP / focal * cv2.dilate(inverse, window)
    background = ~view.may_show_object
    beside, mixed = (cv2.dilate(mask.astype(np.uint8), window) > 0 for mask in (edge, background))
    trust = np.where(mixed, 0.0, np.where(beside, EDGE_WEIGHT, 1.0)).astype(np.float32)
    return TrustedPixels(trust, inverse.astype(np.float32))
