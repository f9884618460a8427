"""Where carving starts: the signed distance to the silhouettes' visual hull, and free space around cameras."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError, SceneError
from recon3d.kernels.silhouettes import Outlines, silhouette_distance
from recon3d.scene.packed import pack_cameras
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import BAND

_CLEARANCE = 3.0  # voxels around a camera that cannot hold matter


def clear_around_cameras(occupied: NDArray[np.bool_], scene: Scene, volume: CarvingVolume) -> None:
    """Empty the voxels (nx, ny, nz) whose centres lie within three voxel sizes of a camera."""
    for center in scene.centers:
        place = (center - volume.origin) / volume.voxel_size - 0.5  # in voxels, centres at integers
        low = np.maximum(np.ceil(place - _CLEARANCE).astype(np.int64), 0)
        high = np.minimum(np.floor(place + _CLEARANCE).astype(np.int64) + 1, volume.shape)
        if (low >= high).any():
            continue
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
        occupied[box] &= np.linalg.norm(grid - place, axis=-1) > _CLEARANCE


_AT_A_TIME = 1 << 24  # pixels of silhouettes


_SIDE = 0.05  # pixels that a silhouette's pixel is at least on its side of the outline


def start_distance(scene: Scene, volume: CarvingVolume) -> NDArray[np.float32]:
    """(nx, ny, nz) signed distance of voxel centres to what may be solid, world units, positive inside.

    That of the visual hull where some view has a silhouette; else all but what lies around the cameras, cut off at
    ``BAND`` voxels.
    """
    if any_silhouette(scene):
        return hull_distance(scene, volume)
    occupied, limit = volume.occupied.copy(), np.float32(BAND * volume.voxel_size)
    clear_around_cameras(occupied, scene, volume)
    return np.where(occupied, limit, -limit)


def hull_distance(scene: Scene, volume: CarvingVolume, *, tolerance: int = 0) -> NDArray[np.float32]:
    """(nx, ny, nz) signed distance of voxel centres to the visual hull, world units, positive inside.

    Cut off at ``BAND`` voxels on either side; where no silhouette says anything it is that far inside.
    """
    views = _checked(scene, tolerance)
    limit = np.float32(BAND * volume.voxel_size)
    field = np.full(volume.shape, limit, np.float32)
    # The smallest distance of all can be found of some views after the others.
    most = len(views) if tolerance else max(1, _AT_A_TIME // max(view.width * view.height for view in views))
    for first in range(0, len(views), most):
        silhouette_distance(volume.lattice.packed, _outlines(views[first : first + most], tolerance), field)
    if not (volume.occupied & (field > 0)).any():
        raise nothing_inside(scene, lambda alone: float((hull_distance(alone, volume) > 0).mean()))
    return np.maximum(field, -limit)


def any_silhouette(scene: Scene) -> bool:
    """Whether some view of a scene has a silhouette."""
    return any(view.has_silhouette for view in scene.views)


def silhouette_outlines(scene: Scene, tolerance: int = 0) -> Outlines:
    """Outlines of a scene's silhouettes, of which at most so many as tolerated, and not all, may be wrong."""
    return _outlines(_checked(scene, tolerance), tolerance)


def _checked(scene: Scene, tolerance: int) -> tuple[View, ...]:
    """The views with a silhouette, more than may be wrong."""
    views = _with_silhouette(scene)
    if not views:
        raise SceneError(f"scene {scene.name}: a visual hull needs silhouettes, and no view has one")
    if not 0 <= tolerance < len(views):
        raise ArgumentError(f"expected a tolerance of 0 to {len(views) - 1} wrong silhouettes, got {tolerance}")
    return views


def _outlines(views: tuple[View, ...], tolerance: int) -> Outlines:
    """Outlines of views that have silhouettes."""
    distances = np.zeros(
        (len(views), max(view.height for view in views), max(view.width for view in views)), np.float32
    )
    for n, view in enumerate(views):
        distances[n, : view.height, : view.width] = outline_distance(view.may_show_object)
    pixel_scales = np.array([1 / np.sqrt(view.K[0, 0] * view.K[1, 1]) for view in views])
    return Outlines(pack_cameras([view.calibration for view in views]), pixel_scales, distances, tolerance)


def nothing_inside(scene: Scene, share: Callable[[Scene], float]) -> EmptyReconstructionError:
    """The error that names the view which excludes most; share gives the part that a hull of one view leaves."""
    alone = []
    views = _with_silhouette(scene)
    for view in views:
        try:
            alone.append(share(Scene((view,), scene.bounds, scene.name)) if len(views) > 1 else 0.0)
        except EmptyReconstructionError:
            alone.append(0.0)
    worst = int(np.argmin(alone))
    return EmptyReconstructionError(
        f"scene {scene.name}: no voxel is inside all silhouettes; {views[worst].name} alone leaves "
        f"{100 * alone[worst]:.1f}% of the volume"
    )


def _with_silhouette(scene: Scene) -> tuple[View, ...]:
    return tuple(view for view in scene.views if view.has_silhouette)


def outline_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(height, width) signed distance in pixels to a silhouette's outline, positive inside; smooth along it."""
    inside = mask.astype(np.uint8)
    if inside.all() or not inside.any():
        return np.full(mask.shape, np.hypot(*mask.shape) * (1 if inside.any() else -1), np.float32)
    to_outside, to_inside = _distance_to_zero(inside), _distance_to_zero(1 - inside)
    # The outline runs half a pixel beside the pixel centres that the distances are between.
    signed = np.where(mask, to_outside - 0.5, 0.5 - to_inside).astype(np.float32)
    smooth = cv2.GaussianBlur(signed, (0, 0), 1.0)
    # Smoothing must not lose what is a pixel or two thin, of the object or of a gap.
    return np.where(mask, np.maximum(smooth, _SIDE), np.minimum(smooth, -_SIDE)).astype(np.float32)


def _distance_to_zero(mask: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(height, width) distance of every pixel to the nearest one that is zero, pixels."""
    distance = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE).astype(np.float64)
    # OpenCV's last bits change from call to call; squares of these distances are whole numbers.
    return np.asarray(np.sqrt(np.rint(distance**2)))
