"""What the views show of voxels, and what a photo-consistency test says of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.spec import ask
from recon3d.kernels.footprints import carve_background, free_pixels, gather, mark
from recon3d.kernels.ragged import mean_colors
from recon3d.kernels.rays import observe
from recon3d.kernels.types import Footprints, Observed, Pixels
from recon3d.kernels.windows import sample_windows
from recon3d.scene.packed import PackedViews
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

_NUMBERS = 1 << 24  # of directions and windows at once: 64 MiB


class UnclaimedPixels:
    """Foreground pixels of the views that no accepted voxel has claimed: P_j(v) = B_j(v) minus marked_j (eq. 5)."""

    def __init__(self, views: PackedViews, volume: CarvingVolume) -> None:
        self.views, self.lattice = views, volume.lattice.packed
        self.mask = views.foreground.copy()
        """(n_views, height, width)."""

    def footprints(self, voxels: NDArray[np.int64]) -> Footprints:
        """Boxes B_j(v), sizes of P_j(v), and whether any image shows the voxel, of voxels (n, 3)."""
        views = self.views
        found = Footprints(
            boxes=np.empty((len(voxels), len(views), 4), np.int32),
            counts=np.empty((len(voxels), len(views)), np.int64),
            in_frame=np.zeros(len(voxels), np.bool_),
        )
        free_pixels(voxels, self.lattice, views.cameras, views.integrals, self.mask, found)
        return found

    def patches(self, boxes: NDArray[np.int32], counts: NDArray[np.int64]) -> Patches:
        """P(v) of every voxel of a batch, by the boxes (n, n_views, 4) and counts (n, n_views) of ``footprints``."""
        pixels = room_for(counts)
        gather(boxes, self.mask, self.views.images, pixels)
        return Patches(*pixels)

    def claim(self, boxes: NDArray[np.int32]) -> None:
        """Take the pixels of accepted voxels' boxes (n, n_views, 4) out."""
        mark(boxes, np.arange(len(boxes)), self.mask)


def starts_of(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, n_views + 1) ``Patches.view_starts`` of so many pixels (n, n_views) one after another."""
    ends = np.cumsum(counts).reshape(counts.shape)
    return np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)


def room_for(counts: NDArray[np.int64]) -> Pixels:
    """Unset colours of so many pixels (n, n_views)."""
    view_starts = starts_of(counts)
    return Pixels(np.empty((int(view_starts[-1, -1]) if view_starts.size else 0, 3), np.uint8), view_starts)


def without_background(views: PackedViews, volume: CarvingVolume) -> tuple[CarvedVolume, NDArray[np.bool_]]:
    """Carved volume with the voxels labelled that project to background alone, and those left (nx, ny, nz)."""
    occupied = volume.occupied.copy()
    carve_background(occupied, volume.lattice.packed, views.cameras, views.integrals)
    hull = CarvedVolume.untouched(volume)
    hull.labels[volume.occupied & ~occupied] = Label.BACKGROUND
    return hull, occupied


def mean_color(patches: Patches) -> NDArray[np.uint8]:
    """(n_voxels, 3) RGB mean of each voxel's pixels, all views together."""
    means = np.empty((patches.n_voxels, 3), np.uint8)
    mean_colors(patches.colors, patches.starts, means)
    return means


def judge(
    test: ConsistencyTest, patches: Patches, centers: NDArray[np.float64], voxel_size: float, views: PackedViews
) -> Verdict:
    """Verdict of a test on the voxels around centres (n, 3), with the directions and windows that the test asks for.

    Such extras take more memory than pixels do, so a test that wants them gets a large batch in parts.
    """
    directed, side = bool(getattr(test, "needs_directions", False)), int(getattr(test, "window_side", 0))
    numbers = len(views) * (3 * directed + side * side)
    if not numbers:
        return ask(test, patches)
    step = max(_NUMBERS // numbers, 1)
    verdicts = []
    for start in range(0, max(len(centers), 1), step):
        points = centers[start : start + step]
        part = patches.part(start, start + len(points))
        directions = _directions(points, views) if directed else None
        windows = _windows(points, part.counts, side, views, voxel_size) if side else None
        verdicts.append(ask(test, Patches(part.colors, part.view_starts, directions, windows)))
    return Verdict(*(np.concatenate([getattr(v, name) for v in verdicts]) for name in ("degree", "low", "high")))


def _directions(centers: NDArray[np.float64], views: PackedViews) -> NDArray[np.float32]:
    """(n, n_views, 3) unit vectors from points (n, 3) to the cameras."""
    toward = views.cameras.centers - centers[:, None]
    length = np.linalg.norm(toward, axis=-1, keepdims=True)
    return np.asarray(toward / np.maximum(length, np.finfo(np.float64).tiny), np.float32)


def _windows(
    centers: NDArray[np.float64], counts: NDArray[np.int64], side: int, views: PackedViews, voxel_size: float
) -> NDArray[np.float32]:
    """(n, n_views, side * side) luminance of the views around points (n, 3); NaN where no pixel sees the voxel.

    Samples lie one pixel apart, as fine as the views are, but farther where the voxel is larger than the window: the
    surface may pass anywhere in it, and views must agree on what the whole voxel shows.
    """
    windows = np.empty((*counts.shape, side, side), np.float32)
    sample_windows(centers, voxel_size, counts, views.cameras, views.images, windows)
    return windows.reshape(*counts.shape, side * side)


def observed_colors(views: PackedViews, occupied: NDArray[np.bool_], volume: CarvingVolume) -> Observed:
    """The occupied voxels (nx, ny, nz) that some image shows, with the mean colour of each footprint."""
    voxels = np.argwhere(occupied)
    colors = np.zeros((len(voxels), len(views), 3), np.uint8)
    seen = np.zeros((len(voxels), len(views)), np.bool_)
    observe(volume.lattice.packed, views.cameras, views.foreground, views.images, Observed(voxels, colors, seen))
    shown = seen.any(axis=1)
    return Observed(voxels[shown], colors[shown], seen[shown])
