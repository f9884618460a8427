"""Space carving: plane sweeps along the six axis directions, for cameras anywhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.hysteresis import keep_connected, label_voxels, neighbour_offsets
from recon3d.carving.method import JudgingMethod
from recon3d.carving.observations import judge, mean_color, room_for, without_background
from recon3d.carving.observer import Observer, Voxel
from recon3d.carving.start import clear_around_cameras
from recon3d.checks import require_whole
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.sweeps import Claims, SweepFootprints, claim, gather_visible, visible_pixels
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

_FREE = np.iinfo(np.int32).max  # a pixel that no layer has claimed


_BATCH = 1 << 15  # voxels judged at once when no layer limits them


@dataclass(frozen=True)
class SpaceCarving(JudgingMethod):
    """Carve the voxels on which the views that see them disagree, until all that is left is photo-consistent.

    A plane sweeps the volume along +x, -x, +y, -y, +z and -z. In each sweep the cameras on the near side of the plane
    count; a layer is judged on the pixels that the layers before it have left free, what fails is carved, and the
    others claim their pixels. Six sweeps are a round; rounds go on until one carves nothing. A voxel is judged
    on all pixels together that show it in any sweep.

    With a test that has two thresholds only ``degree <= low`` is carved at first. When that changes nothing any more,
    candidates that no candidates connect to a consistent voxel are carved too, and the rounds go on.

    Views may be anywhere. Background of their silhouettes never votes, and a voxel whose footprint in some image is
    background alone is carved. Voxels within three voxel sizes of a camera are taken to be empty, so that a camera
    inside the volume can see. With a monotone test (a set found inconsistent stays so when it grows) the result holds
    every photo-consistent shape in the volume.

    Notes
    -----
    Kutulakos and Seitz let every camera before the plane take part. One that lies only just before it looks along the
    layer, whose voxels then hide each other. Here each pixel belongs to the sweep along the largest component
    of its ray: a ray crosses all that it meets in that one sweep, so nothing is lost, and it stays in a layer for one
    voxel or two. Voxels without an empty face neighbour are not visible. What the pixels of the other sweeps show is
    known from their latest run, which never shows more than there is to see, since voxels are only ever removed.

    Needs 5 bytes a pixel and view, and a layer's pixels, beside the images and ``CarvedVolume``'s 11 bytes a voxel.

    References
    ----------
    Kutulakos, Seitz, "A theory of shape by space carving", IJCV 38(3), 2000, section 4 (the sweeps and the union of
    what they show, rebuilt from memory of it). Barhoumi, Bakkay, Zargouba, "Automated photo-consistency test for voxel
    colouring based on fuzzy adaptive hysteresis thresholding", 2013, equation 8 (the hysteresis; its use
    with several sweeps is ours).
    """

    max_rounds: int = 50
    """Stop after so many rounds, whatever is left; what fails then is still dropped."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole("max_rounds", self.max_rounds)

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,
    ) -> CarvedVolume:
        """Sweep a volume round by round.

        Returns
        -------
        CarvedVolume
            Its volume holds the visible, accepted voxels; what no view can see is hidden, and part of
            ``with_interior``.

        Raises
        ------
        EmptyReconstructionError : every voxel was carved.
        """
        volume = CarvingVolume.full(volume)
        offsets = neighbour_offsets(self.connectivity)
        views = scene.packed

        hull, occupied = without_background(views, volume)
        clear_around_cameras(occupied, scene, volume)
        carving = _Carving(views, scene, hull, occupied, self.test, observer)
        carving.drop_unseen()

        for n in range(self.max_rounds):
            carved = 0
            for sweep in range(6):
                carved += carving.sweep(sweep)
                if progress:
                    progress(6 * n + sweep + 1, 6 * self.max_rounds)
            if not carved and not carving.drop_failures(offsets):
                break
        else:
            # Stopped early: what is dropped here uncovers others that no sweep has judged, and they stay hidden.
            carving.drop_failures(offsets)
        if progress:
            progress(6 * self.max_rounds, 6 * self.max_rounds)
        carving.finish()
        if not hull.volume.n_occupied:
            raise EmptyReconstructionError(f"scene {scene.name}: all voxels were carved ({hull.count_text()})")
        return hull


class _Carving:
    """What is left of the volume, and which layer of which sweep has claimed each pixel."""

    def __init__(
        self,
        views: PackedViews,
        scene: Scene,
        hull: CarvedVolume,
        occupied: NDArray[np.bool_],
        test: ConsistencyTest,
        observer: Observer | None,
    ) -> None:
        self.views, self.hull, self.occupied, self.test, self.observer = views, hull, occupied, test, observer
        self.lattice = hull.lattice.packed
        self.claims = Claims(
            sweep_of=np.where(views.foreground, _largest_components(scene, views.foreground.shape), np.int8(-1)),
            first_layers=_first_layers(scene, hull.volume),
            # Nothing is seen through the pixels of a sweep before it has run.
            claimed=np.full(views.foreground.shape, -1, np.int32),
        )

    def drop_unseen(self) -> None:
        """Leave out voxels that lie outside every image, so that they do not hide others."""
        for batch in _batches(self.occupied):
            unseen = batch[~self._footprints(batch).in_frame]
            self.occupied[tuple(unseen.T)] = False

    def sweep(self, sweep: int) -> int:
        """One plane sweep; returns how many voxels it carved."""
        axis, down = divmod(sweep, 2)
        n_layers = self.occupied.shape[axis]
        own = self.claims.sweep_of == sweep
        taking_part = own.any(axis=(1, 2))
        if not taking_part.any():
            return 0
        self.claims.claimed[own] = _FREE
        carved = 0
        for layer in range(n_layers):
            index = n_layers - 1 - layer if down else layer
            voxels = np.insert(np.argwhere(self.occupied.take(index, axis)), axis, index, axis=1)
            if not len(voxels):
                continue
            boxes, _, _, in_sweep = self._footprints(voxels, sweep, taking_part)
            bare = _surface_of_layer(self.occupied, axis, index)[tuple(np.delete(voxels, axis, 1).T)]
            judged = np.flatnonzero(in_sweep & bare)
            _, _, verdict = self._judge(voxels[judged])
            failed = judged[verdict.inconsistent]
            self.occupied[tuple(voxels[failed].T)] = False
            self.hull.set_labels(voxels[failed], Label.INCONSISTENT)
            # Inner voxels claim pixels too: otherwise baring one would hide others that were seen before.
            in_sweep[failed] = False
            claim(self.claims, sweep, layer, boxes, np.flatnonzero(in_sweep))
            carved += len(failed)
        return carved

    def drop_failures(self, offsets: NDArray[np.int64]) -> int:
        """Judge every visible voxel on the pixels of all sweeps, resolve the candidates, and carve what fails.

        Leaves the accepted voxels labelled as consistent and coloured; returns how many were carved.
        """
        hull = self.hull
        hull.labels[self.occupied] = Label.HIDDEN
        surface = hull.volume.with_occupancy(self.occupied).surface()
        candidates = []
        for batch in _batches(surface):
            shown, patches, verdict = self._judge(batch)
            candidates.append(label_voxels(hull.labels, shown, verdict))
            hull.volume.colors[tuple(shown.T)] = mean_color(patches)
        if self.observer:
            self.observer.resolving(hull.labels)
        if candidates:
            keep_connected(hull.labels, np.concatenate(candidates), offsets)
        carved = self.occupied & (hull.labels == Label.INCONSISTENT)
        self.occupied &= ~carved
        return int(np.count_nonzero(carved))

    def finish(self) -> None:
        """Occupy the accepted voxels, and forget what was said of others that are hidden in the end."""
        hull = self.hull
        hull.volume.occupied[:] = hull.labels == Label.CONSISTENT
        hull.volume.colors[~hull.volume.occupied] = 0
        unjudged = ~hull.volume.occupied & (hull.labels != Label.INCONSISTENT)
        hull.degree[unjudged] = np.nan
        hull.n_views[unjudged] = 0

    def _footprints(
        self, voxels: NDArray[np.int64], sweep: int = -1, asked: NDArray[np.bool_] | None = None
    ) -> SweepFootprints:
        """Where voxels (n, 3) lie, and what is visible of them, with regard to one sweep."""
        n_views = len(self.views)
        found = SweepFootprints(
            boxes=np.empty((len(voxels), n_views, 4), np.int32),
            counts=np.empty((len(voxels), n_views), np.int64),
            in_frame=np.zeros(len(voxels), np.bool_),
            in_sweep=np.zeros(len(voxels), np.bool_),
        )
        asked = np.ones(n_views, np.bool_) if asked is None else asked
        visible_pixels(voxels, self.lattice, self.views.cameras, self.claims, sweep, asked, found)
        return found

    def _judge(self, voxels: NDArray[np.int64]) -> tuple[NDArray[np.int64], Patches, Verdict]:
        """Those of the voxels that pixels of any sweep show, all these pixels, and what the test says of them."""
        boxes, counts, _, _ = self._footprints(voxels)
        visible = counts.any(axis=1)
        voxels, boxes, counts = voxels[visible], boxes[visible], counts[visible]
        pixels = room_for(counts)
        gather_visible(voxels, self.lattice, self.claims, boxes, self.views.images, pixels)
        patches = Patches(*pixels)
        lattice = self.hull.lattice
        verdict = judge(self.test, patches, lattice.centers(voxels), lattice.voxel_size, self.views)
        self.hull.record(voxels, verdict.degree, patches.n_views)
        if self.observer:
            self.observer.judged(voxels, patches, verdict, self._showing)
        return voxels, patches, verdict

    def _showing(self, voxel: Voxel) -> NDArray[np.bool_]:
        """(n_views, height, width) pixels that no layer before the voxel's has claimed in their sweep."""
        place = np.array(voxel)
        layers = np.stack([place, np.array(self.occupied.shape) - 1 - place], axis=1).ravel()
        sweep_of, first_layers, claimed = self.claims
        # Pixels of no sweep have the number -1, which looks up some sweep's and is left out.
        first = np.take_along_axis(first_layers, sweep_of.reshape(len(sweep_of), -1), axis=1)
        seen = (first.reshape(sweep_of.shape) <= layers[sweep_of]) & (layers[sweep_of] <= claimed)
        return np.asarray((sweep_of >= 0) & seen)


def _batches(mask: NDArray[np.bool_]) -> Iterator[NDArray[np.int64]]:
    """Voxels (n, 3) of a mask, a slice of the volume or more at a time."""
    thickness = max(_BATCH // max(mask[0].size, 1), 1)
    for start in range(0, len(mask), thickness):
        voxels = np.argwhere(mask[start : start + thickness])
        if len(voxels):
            voxels[:, 0] += start
            yield voxels


def _surface_of_layer(occupied: NDArray[np.bool_], axis: int, index: int) -> NDArray[np.bool_]:
    """Mask of one layer's voxels with an empty face neighbour; beyond the volume is empty."""
    turned = np.moveaxis(occupied, axis, 0)
    layer = turned[index]
    padded = np.pad(layer, 1)
    inner = layer & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    for beside in (index - 1, index + 1):
        inner &= turned[beside] if 0 <= beside < len(turned) else False
    return np.asarray(layer & ~inner)


def _largest_components(scene: Scene, shape: tuple[int, ...]) -> NDArray[np.int8]:
    """(n_views, height, width) sweep along the largest component of every pixel's ray."""
    sweeps = np.zeros(shape, np.int8)
    for n, view in enumerate(scene.views):
        u, v = np.meshgrid(np.arange(view.width), np.arange(view.height))
        camera_rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(view.K).T
        rays = camera_rays @ view.cam_from_world[:3, :3]
        axis = np.abs(rays).argmax(axis=-1)
        down = np.take_along_axis(rays, axis[..., None], -1)[..., 0] < 0
        sweeps[n, : view.height, : view.width] = 2 * axis + down
    return sweeps


def _first_layers(scene: Scene, volume: CarvingVolume) -> NDArray[np.int32]:
    """(n_views, 6) number of the first layer of each sweep that a camera lies before."""
    place = (scene.centers - volume.origin) / volume.voxel_size
    both = np.stack([place, np.array(volume.shape) - place], axis=-1)
    return np.clip(np.ceil(both), 0, _FREE - 1).astype(np.int32).reshape(len(place), 6)
