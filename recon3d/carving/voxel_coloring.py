"""Voxel colouring: one sweep from near to far, as the paper has it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.hysteresis import keep_connected, label_voxels, neighbour_offsets
from recon3d.carving.method import JudgingMethod
from recon3d.carving.observations import UnclaimedPixels, judge, mean_color, without_background
from recon3d.carving.observer import Observer
from recon3d.carving.visibility import require_sweep_direction
from recon3d.checks import require_choice
from recon3d.errors import EmptyReconstructionError
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

Layering = Literal["slabs", "voxels"]


@dataclass(frozen=True)
class VoxelColoring(JudgingMethod):
    """Colour the voxels that the views agree on, visiting each once, from the cameras into the volume.

    The paper's own method. The views must satisfy the ordinal visibility constraint. Background of their silhouettes
    never votes, and a voxel whose footprint in some image is background alone is carved.

    Voxels of a layer (a slab one voxel thick) do not hide each other: the layer is judged against the pixels that
    earlier layers have claimed, its candidates are resolved by connected components together with the voxels
    accepted so far, and only then does it claim pixels.

    References
    ----------
    Barhoumi, Bakkay, Zargouba, "Automated photo-consistency test for voxel colouring based on fuzzy adaptive
    hysteresis thresholding", 2013, section 3. Seitz, Dyer, "Photorealistic scene reconstruction by voxel coloring",
    1999 (the layers).
    """

    one_sided: ClassVar[bool] = True

    layering: Layering = "slabs"
    """"slabs" as above, independent of the order inside a layer; "voxels" is the paper's literal reading in which every
    voxel sees the claims of every earlier one: depends on that order, and is slow."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("layering", self.layering, get_args(Layering))

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,
    ) -> CarvedVolume:
        """Sweep the layers of a volume from near to far.

        Returns
        -------
        CarvedVolume
            Its volume holds the accepted voxels: the visible surface, without the hidden inside.

        Raises
        ------
        VisibilityError : the views break the ordinal visibility constraint; names those to leave out.
        EmptyReconstructionError : every voxel was carved.
        """
        volume = CarvingVolume.full(volume)
        lattice, offsets = volume.lattice, neighbour_offsets(self.connectivity)
        direction = require_sweep_direction(scene, volume.bounds).direction
        views, unclaimed = scene.packed, UnclaimedPixels(scene.packed, volume)

        hull, occupied = without_background(views, volume)

        layers = list(near_to_far(occupied, direction, self.layering))
        for n, layer in enumerate(layers):
            # P_j(v) = B_j(v) minus marked_j (eq. 5)
            boxes, counts, in_frame = unclaimed.footprints(layer)
            visible = counts.any(axis=1)
            hull.set_labels(layer[~visible & in_frame], Label.HIDDEN)
            voxels, boxes = layer[visible], boxes[visible]
            patches = unclaimed.patches(boxes, counts[visible])

            # mu(v), T_low and T_high, for the paper's test (eq. 7 and 9)
            verdict = judge(self.test, patches, lattice.centers(voxels), lattice.voxel_size, views)
            hull.record(voxels, verdict.degree, patches.n_views)
            if observer:
                observer.judged(voxels, patches, verdict, lambda _: unclaimed.mask)

            # Hysteresis (eq. 8)
            candidates = label_voxels(hull.labels, voxels, verdict)
            if observer:
                observer.resolving(hull.labels)
            keep_connected(hull.labels, candidates, offsets)

            accepted = hull.labels[tuple(voxels.T)] == Label.CONSISTENT
            hull.accept(voxels[accepted], mean_color(patches)[accepted])
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
