"""Colours of the voxels that some pixel sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.kernels.ragged import mean_colors
from recon3d.volume.carved import CarvedVolume, Label


def color_visible(hull: CarvedVolume, buffer: ItemBuffer, occupied: NDArray[np.bool_]) -> None:
    """Accept the occupied voxels (nx, ny, nz) that some pixel sees, in the mean colour of its pixels."""
    buffer.advance(occupied)
    visible = buffer.visible()
    patches = buffer.patches(visible)
    means = np.empty((len(visible), 3), np.uint8)
    mean_colors(patches.colors, patches.starts, means)
    voxels = np.column_stack(np.unravel_index(visible, occupied.shape))
    hull.n_views[tuple(voxels.T)] = patches.n_views
    hull.set_labels(voxels, Label.CONSISTENT)
    hull.accept(voxels, means)
