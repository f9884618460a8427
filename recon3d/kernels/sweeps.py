"""Plane sweeps along the axes: which pixels a voxel shows, and the layers that claimed them.

Sweep 2 a goes up axis a, sweep 2 a + 1 down; layers are numbered from the side where the sweep begins.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.footprints import footprint


@kernel()
def _layer(voxels: NDArray[np.int64], n: int, shape: NDArray[np.int64], sweep: int) -> Any:
    """Number of the layer of a sweep that voxel n lies in."""
    axis = sweep // 2
    index = voxels[n, axis]
    return shape[axis] - 1 - index if sweep & 1 else index


@kernel(parallel=True)
def visible_pixels(
    part: Part,
    voxels: NDArray[np.int64],
    shape: NDArray[np.int64],
    origin: NDArray[np.float64],
    size: float,
    projections: NDArray[np.float64],
    image_sizes: NDArray[np.int64],
    sweep_of: NDArray[np.int8],
    first_layers: NDArray[np.int32],
    claimed: NDArray[np.int32],
    sweep: int,
    asked: NDArray[np.bool_],
    boxes: NDArray[np.int32],
    counts: NDArray[np.int64],
    in_frame: NDArray[np.bool_],
    in_sweep: NDArray[np.bool_],
) -> None:
    """Footprints of voxels (n, 3), visible pixels in each view, and whether any is foreground or of the sweep.

    A pixel shows the voxel unless a layer before the voxel's has claimed it. Views that are not asked show nothing.
    """
    for n in span(part, voxels.shape[0]):
        x = origin[0] + voxels[n, 0] * size
        y = origin[1] + voxels[n, 1] * size
        z = origin[2] + voxels[n, 2] * size
        for view in range(projections.shape[0]):
            u0, u1, v0, v1 = 0, -1, 0, -1
            if asked[view]:
                u0, u1, v0, v1, _ = footprint(
                    projections[view], image_sizes[view, 0], image_sizes[view, 1], x, y, z, size
                )
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
                    layer = _layer(voxels, n, shape, own)
                    if first_layers[view, own] <= layer <= claimed[view, v, u]:
                        count += 1
                        if own == sweep:
                            in_sweep[n] = True
            counts[n, view] = count


@kernel(parallel=True)
def gather_visible(
    part: Part,
    voxels: NDArray[np.int64],
    shape: NDArray[np.int64],
    boxes: NDArray[np.int32],
    view_starts: NDArray[np.int64],
    sweep_of: NDArray[np.int8],
    first_layers: NDArray[np.int32],
    claimed: NDArray[np.int32],
    images: NDArray[np.uint8],
    colors: NDArray[np.uint8],
) -> None:
    """Copy the visible pixels of all footprints into one ragged array, voxel by voxel, view by view."""
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
                    layer = _layer(voxels, n, shape, own)
                    if first_layers[view, own] <= layer <= claimed[view, v, u]:
                        colors[target, 0] = images[view, v, u, 0]
                        colors[target, 1] = images[view, v, u, 1]
                        colors[target, 2] = images[view, v, u, 2]
                        target += 1


@kernel(parallel=True)
def claim(
    part: Part,
    boxes: NDArray[np.int32],
    kept: NDArray[np.int64],
    sweep: int,
    layer: int,
    sweep_of: NDArray[np.int8],
    first_layers: NDArray[np.int32],
    claimed: NDArray[np.int32],
) -> None:
    """Let the kept voxels of a layer claim those pixels of the sweep in their footprints that are still free."""
    for view in span(part, boxes.shape[1]):
        if layer < first_layers[view, sweep]:
            continue
        for n in kept:
            for v in range(boxes[n, view, 2], boxes[n, view, 3] + 1):
                for u in range(boxes[n, view, 0], boxes[n, view, 1] + 1):
                    if sweep_of[view, v, u] == sweep and claimed[view, v, u] > layer:
                        claimed[view, v, u] = layer
