"""The visual hull: what all silhouettes have in common."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.photo_hull import Label, PhotoHull, Progress
from recon3d.carving.views import ViewArrays
from recon3d.consistency import ConsistencyTest
from recon3d.errors import EmptyReconstructionError, SceneError
from recon3d.kernels.ragged import mean_colors
from recon3d.kernels.silhouettes import silhouette_distance
from recon3d.scene import Scene
from recon3d.volume import CarvingVolume

BAND = 3.0
"""Voxels beside the surface within which the distance field is kept."""


def visual_hull(
    scene: Scene,
    volume: CarvingVolume,
    test: ConsistencyTest | None = None,  # noqa: ARG001 # methods are called alike
    *,
    tolerance: int = 0,
    progress: Progress | None = None,
) -> PhotoHull:
    """Intersect the silhouettes' cones, to a fraction of a voxel.

    A voxel is inside when the signed distance of its centre's projection to every silhouette's outline is positive.
    The distances are kept, so that the surface is smooth rather than stair-stepped. A view says nothing of what lies
    outside its image or behind it, nor one without silhouette.

    Parameters
    ----------
    test : not used.
    tolerance : silhouettes that may be wrong about a voxel; k out of n exclude it only if k > tolerance.

    Returns
    -------
    PhotoHull
        Consistent: the voxels that some pixel sees, with the mean colour of its pixels; hidden: the others inside.

    Raises
    ------
    SceneError : no view has a silhouette.
    EmptyReconstructionError : nothing is inside; names the view that excludes most.

    References
    ----------
    Laurentini, "The visual hull concept for silhouette-based image understanding", PAMI 1994.
    """
    field = hull_distance(scene, volume, tolerance=tolerance)
    views = ViewArrays(scene)
    occupied = volume.occupied & (field > 0)
    hull = PhotoHull.untouched(volume, field)
    hull.labels[volume.occupied] = np.where(occupied[volume.occupied], Label.HIDDEN, Label.BACKGROUND)
    color_visible(hull, ItemBuffer(views, volume), occupied)
    if progress:
        progress(1, 1)
    return hull


def hull_distance(scene: Scene, volume: CarvingVolume, *, tolerance: int = 0) -> NDArray[np.float32]:
    """(nx, ny, nz) signed distance of voxel centres to the visual hull, world units, positive inside.

    Cut off at ``BAND`` voxels on either side; where no silhouette says anything it is that far inside.
    """
    views = [view for view in scene.views if view.silhouette is not None]
    if not views:
        raise SceneError(f"scene {scene.name}: a visual hull needs silhouettes, and no view has one")
    if not 0 <= tolerance < len(views):
        raise ValueError(f"expected a tolerance of 0 to {len(views) - 1} wrong silhouettes, got {tolerance}")
    arrays = ViewArrays(Scene(tuple(views), scene.bounds, scene.name))
    distances = np.zeros(arrays.free.shape, np.float32)
    for n, view in enumerate(views):
        distances[n, : view.height, : view.width] = outline_distance(arrays.free[n, : view.height, : view.width])
    pixel_scales = np.array([1 / np.sqrt(view.K[0, 0] * view.K[1, 1]) for view in views])
    limit = np.float32(BAND * volume.voxel_size)
    field = np.full(volume.shape, limit, np.float32)
    silhouette_distance(
        volume.origin, volume.voxel_size, arrays.projections, arrays.sizes, pixel_scales, distances, tolerance, field
    )
    if not (volume.occupied & (field > 0)).any():
        alone = []
        for view in views:
            only = Scene((view,), scene.bounds, scene.name)
            alone.append(float((hull_distance(only, volume) > 0).mean()) if len(views) > 1 else 0.0)
        worst = int(np.argmin(alone))
        raise EmptyReconstructionError(
            f"scene {scene.name}: no voxel is inside all silhouettes; {views[worst].name} alone leaves "
            f"{100 * alone[worst]:.1f}% of the volume"
        )
    return np.maximum(field, -limit)


def outline_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(height, width) signed distance in pixels to a silhouette's outline, positive inside; smooth along it."""
    inside = mask.astype(np.uint8)
    if inside.all() or not inside.any():
        return np.full(mask.shape, np.hypot(*mask.shape) * (1 if inside.any() else -1), np.float32)
    to_outside = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    to_inside = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # The outline runs half a pixel beside the pixel centres that the distances are between.
    signed = np.where(mask, to_outside - 0.5, 0.5 - to_inside).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(signed, (0, 0), 1.0), np.float32)


def color_visible(hull: PhotoHull, buffer: ItemBuffer, occupied: NDArray[np.bool_]) -> None:
    """Accept the occupied voxels that some pixel sees, in the mean colour of its pixels."""
    buffer.advance(occupied)
    visible = buffer.visible()
    patches = buffer.patches(visible)
    means = np.empty((len(visible), 3), np.uint8)
    mean_colors(patches.colors, patches.starts, means)
    voxels = np.column_stack(np.unravel_index(visible, occupied.shape))
    hull.n_views[tuple(voxels.T)] = patches.n_views
    hull.set_labels(voxels, Label.CONSISTENT)
    hull.accept(voxels, means)
