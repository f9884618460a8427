"""Parts that silhouettes show and a mesh has lost because they are thinner than a voxel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.rendering.renderer import Renderer
from recon3d.scene.bounds import Bounds
from recon3d.scene.regions import bounds_mask
from recon3d.scene.view import View

_LENGTH = 4.0  # voxels that a lost part is long at least
_PIXELS = 8.0  # the same in pixels
_FEWEST, _SHARE = 2, 0.3  # views, and of those with silhouettes, that show lost parts
_LOOKED_AT = 8  # views of many
_VOXELS = 2.0  # across a part that is kept


class ThinParts(NamedTuple):
    """Thin parts of the object that a mesh lacks."""

    views: tuple[str, ...]
    """Names of the views, of those that were looked at, whose silhouettes show such parts."""
    voxel_size: float
    """That keeps them, world units."""


def lost_thin_parts(
    mesh: o3d.geometry.TriangleMesh, views: Sequence[View], bounds: Bounds, voxel_size: float
) -> ThinParts | None:
    """Long parts of the silhouettes, about two voxels wide or less, that a mesh does not cover in several views.

    Parameters
    ----------
    mesh : in the world of the views.
    views : at most eight that have silhouettes are looked at.
    voxel_size : that the mesh was made with, world units.
    """
    masked = [view for view in views if view.has_silhouette]
    if len(masked) < _FEWEST or not len(mesh.triangles):
        return None
    chosen = np.unique(np.linspace(0, len(masked) - 1, min(_LOOKED_AT, len(masked))).round().astype(int))
    renderer, names, widths = Renderer(mesh), [], []
    for view in (masked[n] for n in chosen):
        footprint = float(view.project(bounds.center[None])[1][0]) / np.sqrt(view.K[0, 0] * view.K[1, 1])
        if footprint <= 0:
            continue
        voxel = voxel_size / footprint
        thin = _thin(np.asarray(view.silhouette) & bounds_mask(bounds, view), voxel)
        if not thin.any():
            continue
        shown = renderer.cast(view.K, view.cam_from_world, view.width, view.height).hit
        lost = _long_parts(thin & ~_within(shown, np.ceil(voxel)), voxel)
        if lost:
            names.append(view.name)
            widths.append(float(np.median(lost)) * footprint)
    if len(names) < max(_FEWEST, _SHARE * len(chosen)):
        return None
    return ThinParts(tuple(names), min(float(np.median(widths)) / _VOXELS, voxel_size / _VOXELS))


def _thin(mask: NDArray[np.bool_], voxel: float) -> NDArray[np.bool_]:
    """(height, width) what of a mask is thinner than about two voxels, of a size in pixels."""
    radius = float(np.ceil(voxel))
    return mask & ~_within(~_within(~mask, radius), radius)


def _within(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """(height, width) pixels no farther than a radius from those of a mask; by distances, as radii may be large."""
    if not mask.any():
        return mask
    return np.asarray(cv2.distanceTransform((~mask).view(np.uint8), cv2.DIST_L2, 5)) <= radius


def _long_parts(lost: NDArray[np.bool_], voxel: float) -> list[float]:
    """Widths, pixels, of the connected parts that are long and thin, voxels being of a size in pixels."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(lost.astype(np.uint8), connectivity=8)
    sizes = np.asarray(stats)[1:]
    lengths = np.hypot(sizes[:, cv2.CC_STAT_WIDTH], sizes[:, cv2.CC_STAT_HEIGHT])
    widths = sizes[:, cv2.CC_STAT_AREA] / np.maximum(lengths, 1)
    long = (lengths >= max(_LENGTH * voxel, _PIXELS)) & (widths <= 2 * max(voxel, 1))
    return [float(width) for width in widths[long]]
