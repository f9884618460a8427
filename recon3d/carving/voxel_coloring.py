"""Voxel colouring: one sweep from near to far, as the paper has it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.hysteresis import CANDIDATE, Connectivity, neighbour_offsets
from recon3d.carving.observations import UnclaimedPixels, carve_background, judge
from recon3d.carving.observer import Observer
from recon3d.carving.visibility import require_sweep_direction
from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.lattice import grow_consistent
from recon3d.kernels.ragged import mean_colors
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume

Layering = Literal["slabs", "voxels"]


def voxel_coloring(
    scene: Scene,
    volume: CarvingVolume,
    test: ConsistencyTest | None = None,
    *,
    connectivity: Connectivity = 26,
    layering: Layering = "slabs",
    progress: Progress | None = None,
    observer: Observer | None = None,
) -> CarvedVolume:
    """Colour the voxels that the views agree on, visiting each once, from the cameras into the volume.

    Voxels of a layer (a slab one voxel thick) do not hide each other: the layer is judged against the pixels that
    earlier layers have claimed, its candidates are resolved by connected components together with the voxels
    accepted so far, and only then does it claim pixels.

    Parameters
    ----------
    scene : views that satisfy the ordinal visibility constraint. Background of their silhouettes never votes, and a
        voxel whose footprint in some image is background alone is carved.
    volume : where to look; only its occupied voxels are visited.
    test : the photo-consistency test; the paper's fuzzy test when None.
    connectivity : neighbours that carry a candidate: 6 (faces), 18 (edges), 26 (corners).
    layering : "slabs" as above, independent of the order inside a layer; "voxels" is the paper's literal reading in
        which every voxel sees the claims of every earlier one: depends on that order, and is slow.
    progress : called with the number of layers done and of all.
    observer : told of every layer as it is judged.

    Returns
    -------
    CarvedVolume
        Its volume holds the accepted voxels: the visible surface, without the hidden inside.

    Raises
    ------
    VisibilityError : the views break the constraint; names those to leave out.
    EmptyReconstructionError : every voxel was carved.

    References
    ----------
    Barhoumi, Bakkay, Zargouba, "Automated photo-consistency test for voxel colouring based on fuzzy adaptive
    hysteresis thresholding", 2013, section 3. Seitz, Dyer, "Photorealistic scene reconstruction by voxel coloring",
    1999 (the layers).
    """
    test = FuzzyAdaptiveHysteresis() if test is None else test
    offsets = neighbour_offsets(connectivity)
    direction = require_sweep_direction(scene, volume.bounds).direction
    views, unclaimed = scene.packed, UnclaimedPixels(scene.packed, volume)

    hull = CarvedVolume.untouched(volume)
    occupied = volume.occupied.copy()
    carve_background(views, occupied, volume)
    hull.labels[volume.occupied & ~occupied] = Label.BACKGROUND

    layers = list(near_to_far(occupied, direction, layering))
    for n, layer in enumerate(layers):
        boxes, counts, in_frame = unclaimed.footprints(layer)
        visible = counts.any(axis=1)
        hull.set_labels(layer[~visible & in_frame], Label.HIDDEN)

        shown, boxes = layer[visible], boxes[visible]
        patches = unclaimed.patches(boxes, counts[visible])
        verdict = judge(test, patches, volume.origin + volume.voxel_size * (shown + 0.5), volume.voxel_size, views)
        hull.record(shown, verdict.degree, patches.n_views)
        if observer:
            observer.judged(shown, patches, verdict, lambda _: unclaimed.mask)

        consistent = verdict.degree >= verdict.high
        candidate = ~consistent & (verdict.degree > verdict.low)
        hull.set_labels(shown[consistent], Label.CONSISTENT)
        hull.set_labels(shown[candidate], CANDIDATE)
        if observer:
            observer.resolving(hull.labels)
        grow_consistent(hull.labels, shown[candidate], offsets, CANDIDATE, int(Label.CONSISTENT))

        accepted = hull.labels[tuple(shown.T)] == Label.CONSISTENT
        hull.set_labels(shown[~accepted], Label.INCONSISTENT)
        means = np.empty((len(shown), 3), np.uint8)
        mean_colors(patches.colors, patches.starts, means)
        hull.accept(shown[accepted], means[accepted])
        unclaimed.claim(boxes[accepted])
        if progress:
            progress(n + 1, len(layers))

    if not hull.volume.n_occupied:
        raise EmptyReconstructionError(f"scene {scene.name}: all voxels were carved ({hull.count_text()})")
    return hull


def near_to_far(
    occupied: NDArray[np.bool_], direction: NDArray[np.float64], layering: Layering = "slabs"
) -> Iterator[NDArray[np.int64]]:
    """Layers (n, 3) of voxel indices in sweep order: by depth of the centre along the direction, then by index."""
    if layering not in ("slabs", "voxels"):
        raise ValueError(f"expected layering 'slabs' or 'voxels', got {layering!r}")
    voxels = np.argwhere(occupied)
    if not len(voxels):
        return
    # In voxels; rounded, so that a lattice plane along an axis is one layer whatever the last bit says.
    depth = np.round(voxels @ direction, 6)
    key = np.floor(depth - depth.min()).astype(np.int32) if layering == "slabs" else depth
    order = np.argsort(key, kind="stable")
    boundaries = np.flatnonzero(np.diff(key[order])) + 1 if layering == "slabs" else np.arange(1, len(order))
    for part in np.split(order, boundaries):
        yield voxels[part]
