"""Plane sweeps along the axes: which pixels a voxel shows, and the layers that claimed them.

Sweep 2 a goes up axis a, sweep 2 a + 1 down; layers are numbered from the side where the sweep begins.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.footprints import footprint
from recon3d.kernels.lattice import corner_of
from recon3d.kernels.types import Cameras, Lattice, Pixels


class Claims(NamedTuple):
    """What each pixel shows by the sweep that it belongs to."""

    sweep_of: NDArray[np.int8]
    """(n_views, height, width) sweep of the pixel; negative in the background."""
    first_layers: NDArray[np.int32]
    """(n_views, 6) number of the first layer of each sweep that the camera lies before."""
    claimed: NDArray[np.int32]
    """(n_views, height, width) layer that claimed the pixel."""


class SweepFootprints(NamedTuple):
    """Where voxels lie in the views, and what of that is visible in any sweep."""

    boxes: NDArray[np.int32]
    """(n, n_views, 4) as those of ``Footprints``; none in views that are not asked."""
    counts: NDArray[np.int64]
    """(n, n_views) visible pixels."""
    in_frame: NDArray[np.bool_]
    """(n,) whether foreground of any view lies in the voxel's boxes."""
    in_sweep: NDArray[np.bool_]
    """(n,) whether any of the visible pixels are of the sweep that is asked for."""


@kernel()
def _layer(voxels: NDArray[np.int64], n: int, shape: Any, sweep: int) -> Any:
    """Number of the layer of a sweep that voxel n lies in."""
    axis = sweep // 2
    index = voxels[n, axis]
    return shape[axis] - 1 - index if sweep & 1 else index


@kernel(parallel=True)
def visible_pixels(
    part: Part,
    voxels: NDArray[np.int64],
    lattice: Lattice,
    cameras: Cameras,
    claims: Claims,
    sweep: int,
    asked: NDArray[np.bool_],
    found: SweepFootprints,
) -> None:
    """Footprints of voxels (n, 3), visible pixels in each view, and whether any is foreground or of the sweep.

    A pixel shows the voxel unless a layer before the voxel's has claimed it. Views that are not asked show nothing.
    """
    sweep_of, first_layers, claimed = claims
    boxes, counts, in_frame, in_sweep = found
    for n in span(part, voxels.shape[0]):
        corner = corner_of(lattice, voxels[n, 0], voxels[n, 1], voxels[n, 2])
        for view in range(boxes.shape[1]):
            u0, u1, v0, v1 = 0, -1, 0, -1
            if asked[view]:
                u0, u1, v0, v1, _ = footprint(cameras, view, corner, lattice.voxel_size)
            boxes[n, view, 0] = u0
            boxes[n, view, 1] = u1
            boxes[n, view, 2] = v0
            boxes[n, view, 3] = v1
            count = 0
            for v in range(v0, v1 + 1):
                for u in range(u0, u1 + 1):
                    own = sweep_of[view, v, u]
                    if own < 0:
                        continue
                    in_frame[n] = True
                    layer = _layer(voxels, n, lattice.shape, own)
                    if first_layers[view, own] <= layer <= claimed[view, v, u]:
                        count += 1
                        if own == sweep:
                            in_sweep[n] = True
            counts[n, view] = count


@kernel(parallel=True)
def gather_visible(
    part: Part,
    voxels: NDArray[np.int64],
    lattice: Lattice,
    claims: Claims,
    boxes: NDArray[np.int32],
    images: NDArray[np.uint8],
    pixels: Pixels,
) -> None:
    """Copy the visible pixels of all footprints into one ragged array, voxel by voxel, view by view."""
    sweep_of, first_layers, claimed = claims
    colors, view_starts = pixels
    for n in span(part, boxes.shape[0]):
        for view in range(boxes.shape[1]):
            target = view_starts[n, view]
            if target == view_starts[n, view + 1]:
                continue
            for v in range(boxes[n, view, 2], boxes[n, view, 3] + 1):
                for u in range(boxes[n, view, 0], boxes[n, view, 1] + 1):
                    own = sweep_of[view, v, u]
                    if own < 0:
                        continue
                    layer = _layer(voxels, n, lattice.shape, own)
                    if first_layers[view, own] <= layer <= claimed[view, v, u]:
                        colors[target, 0] = images[view, v, u, 0]
                        colors[target, 1] = images[view, v, u, 1]
                        colors[target, 2] = images[view, v, u, 2]
                        target += 1


@kernel(parallel=True)
def claim(
    part: Part, claims: Claims, sweep: int, layer: int, boxes: NDArray[np.int32], kept: NDArray[np.int64]
) -> None:
    """Let the kept voxels of a layer claim those pixels of the sweep in their footprints that are still free."""
    sweep_of, first_layers, claimed = claims
    for view in span(part, boxes.shape[1]):
        if layer < first_layers[view, sweep]:
            continue
        for n in kept:
            for v in range(boxes[n, view, 2], boxes[n, view, 3] + 1):
                for u in range(boxes[n, view, 0], boxes[n, view, 1] + 1):
                    if sweep_of[view, v, u] == sweep and claimed[view, v, u] > layer:
                        claimed[view, v, u] = layer
