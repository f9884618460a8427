"""Colours of the voxels that some pixel sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.observations import mean_color
from recon3d.volume.carved import CarvedVolume, Label


def color_visible(hull: CarvedVolume, buffer: ItemBuffer, occupied: NDArray[np.bool_]) -> None:
    """Accept the occupied voxels (nx, ny, nz) that some pixel sees, in the mean colour of its pixels."""
    buffer.advance(occupied)
    visible = buffer.visible()
    patches = buffer.patches(visible)
    voxels = np.column_stack(np.unravel_index(visible, occupied.shape))
    hull.n_views[tuple(voxels.T)] = patches.n_views
    hull.set_labels(voxels, Label.CONSISTENT)
    hull.accept(voxels, mean_color(patches))
