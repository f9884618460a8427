"""Carving by the votes of depth maps."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_propagation, gaussian_filter

from recon3d.kernels.depth_maps import add_depths
from recon3d.kernels.types import Cameras, DepthMaps, Votes
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

MIN_DEVIATION = 1.0
"""Grey levels; a window with less contrast has nothing to match."""


def hull_of_field(field: NDArray[np.float32], carved: NDArray[np.integer], volume: CarvingVolume) -> CarvedVolume:
    """Hull of the voxels with a positive signed distance (nx, ny, nz), all hidden; labels of the others are given."""
    hull = CarvedVolume.untouched(volume, field.astype(np.float32))
    hull.labels[...] = np.where(field > 0, Label.HIDDEN, carved)
    return hull


def carve_by_depths(
    field: NDArray[np.float32],
    volume: CarvingVolume,
    cameras: Cameras,
    maps: Iterable[DepthMaps],
    *,
    resolution: float,
    truncation: float,
    prior: float,
    margin: float = 0.0,
) -> NDArray[np.float32]:
    """Signed distance field (nx, ny, nz) after the depth maps' votes; never larger than before but in filled holes.

    Only what is solid so far is asked, so that the blur draws a surface out towards the present one, by up to 0.7
    voxels. Asking what lies before it, too, puts the surface of a ball where it is, but bites into thin parts: dense
    matching that starts there measures 78.3% of a rendered cow to 0.25 mm, instead of 79.2% to 0.19 mm.

    Parameters
    ----------
    cameras : of all views.
    maps : one after the other, each of the next one or more views; pixels with a weight of 0 do not vote.
    resolution : width of the blur that joins votes, and unit of the margin; world units.
    truncation : how far before and behind a depth it is evidence for the surface's exact place, world units.
    prior : weight of the vote for solid that every voxel starts with.
    margin : resolutions left in front of the surface found.
    """
    occupied = field > 0
    voxels = np.argwhere(occupied)
    near = Votes(np.zeros(len(voxels)), np.zeros(len(voxels)))
    first = 0
    for each in maps:
        last = first + len(each.depths)
        add_depths(voxels, volume.lattice.packed, cameras.part(range(first, last)), each, truncation, near)
        first = last
    votes, weight = np.zeros(volume.shape, np.float32), np.zeros(volume.shape, np.float32)
    votes[occupied], weight[occupied] = near.distance, near.support
    # Blurred together with their weights, so that one stray ray cannot bore a hole.
    blur = resolution / volume.voxel_size
    votes, weight = gaussian_filter(votes, blur), gaussian_filter(weight, blur)
    judged = (votes + prior * truncation) / (weight + prior)
    carved = np.where(occupied, np.minimum(field, judged + margin * resolution), field)
    # A cavity without an opening was seen by nobody; one around a camera opens into what was empty before.
    empty = np.pad(carved <= 0, 1, constant_values=True)
    opening = np.pad(~occupied, 1, constant_values=True)
    carved[~binary_propagation(opening, mask=empty)[1:-1, 1:-1, 1:-1] & (carved <= 0)] = volume.voxel_size
    return np.asarray(carved, np.float32)
