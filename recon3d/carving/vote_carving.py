"""Carving by the votes of neighbouring views: the visual hull, or the whole box, refined by what these agree on."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from recon3d.carving.depth_votes import MIN_DEVIATION, carve_by_depths, hull_of_field
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.method import Method
from recon3d.carving.observer import Observer
from recon3d.carving.start import start_distance
from recon3d.carving.visible import color_visible
from recon3d.checks import require_number
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.depth_maps import count_agreements
from recon3d.kernels.matching import Tried, Window, best_depths
from recon3d.kernels.types import Compared, DepthMaps
from recon3d.scene.neighbours import matching_neighbours
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice

_FINEST = 2.0  # pixel footprints; a window is twice as wide


@dataclass(frozen=True)
class _Round:
    """One pass: match every view along its rays from the present surface, vote, carve."""

    stride: int
    """Pixels between matched pixels."""
    reach: float
    """How deep behind the surface to look, as a fraction of the bounds' shortest side; of their diagonal where that is
    all of it and the background is unknown."""
    step: float
    """Between tried depths, pixel footprints."""
    prior: float
    """Weight of the vote for solid that every voxel starts with; a clear match weighs up to one."""
    radius: int
    """Of the windows, pixels."""
    spacing: int
    """Between compared pixels of a window."""
    margin: float
    """Resolutions that this pass leaves in front of the surface it found."""


_ROUNDS = (
    _Round(stride=4, reach=1.0, step=2.5, prior=0.3, radius=4, spacing=2, margin=1.5),  # find the cavities
    _Round(stride=2, reach=0.1, step=1.25, prior=0.05, radius=2, spacing=1, margin=0.0),  # find the surface
)


@dataclass(frozen=True)
class VoteCarving(Method):
    """Carve the visual hull, or the box, where neighbouring views agree that the surface lies deeper.

    A threshold on all pixels of a voxel is set by the two least similar of its views, so it either keeps everything or
    tears true surface. Here each view is matched by itself: along the ray of a pixel, from the present surface inwards,
    at which depth does the window around it correlate best with views 5 to 60 degrees away? An occluded or grazing
    view then merely has no good answer. Depths that no second view confirms are dropped; the others vote: for empty
    before them, for solid just behind. Voxels without votes are kept, as are unseen cavities.

    Two passes: a coarse one, as deep as the bounds' shortest side, for the cavities, a fine one near the surface
    found. Where a view has no silhouette, the coarse one looks as deep as the bounds' diagonal, behind which lies the
    background. The result lies inside the visual hull of the silhouettes there are, and its distance field gives the
    surface to a fraction of a voxel. Photographs whose pixels are far below the voxels are read at a smaller scale.

    References
    ----------
    Vogiatzis, Hernandez, Torr, Cipolla, "Multiview stereo via volumetric graph-cuts and occlusion robust
    photo-consistency", PAMI 2007 (votes along rays). Curless, Levoy, "A volumetric method for building complex models
    from range images", SIGGRAPH 1996 (truncated signed distances).
    """

    min_score: float = 0.6
    """Mean of the two best normalised cross-correlations that counts as a match, in (-1, 1)."""
    truncation: float = 4.0
    """How far before and behind a depth it is evidence for the surface's exact place; in voxels, or in two pixel
    footprints where that is more."""

    def __post_init__(self) -> None:
        require_number("min_score", self.min_score, "(-1, 1)")
        require_number("truncation", self.truncation, "(0, inf)")

    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,  # noqa: ARG002 # no verdicts are made
    ) -> CarvedVolume:
        """Match, vote and carve in two passes.

        Returns
        -------
        CarvedVolume
            Consistent: the voxels that some pixel sees, coloured; hidden: the others inside; inconsistent: carved by
            votes. ``distance`` is the signed distance to the surface.

        Raises
        ------
        SceneError : no two views can be matched.
        EmptyReconstructionError : nothing was left.
        """
        volume = CarvingVolume.full(volume)
        neighbours = matching_neighbours(scene)
        scale = reading_scale(scene, volume.voxel_size)
        views, footprint = scene.packed_at(scale), scene.pixel_footprint / scale
        resolution = max(volume.voxel_size, _FINEST * footprint)
        start_field = start_distance(scene, volume)
        inside = volume.occupied & (start_field > 0)
        field = np.where(volume.occupied, start_field, np.minimum(start_field, -volume.voxel_size))
        matcher = _Matcher(scene, volume, views, neighbours, self.min_score, resolution, footprint)
        for n, each in enumerate(_ROUNDS):
            buffer = ItemBuffer(views, volume)
            buffer.advance(field > 0)
            field = carve_by_depths(
                field, volume, views.cameras, [matcher.depth_maps(buffer, each)], resolution=resolution,
                truncation=self.truncation * resolution, prior=each.prior, margin=each.margin,
            )  # fmt: skip
            if progress:
                progress(n + 1, len(_ROUNDS))

        if not (field > 0).any():
            raise EmptyReconstructionError(
                f"scene {scene.name}: the votes carved all {inside.sum():,} voxels that may be solid"
            )
        labels = np.where(volume.occupied, np.where(inside, Label.INCONSISTENT, Label.BACKGROUND), Label.UNSEEN)
        hull = hull_of_field(field, labels, volume)
        color_visible(hull, ItemBuffer(views, volume), field > 0)
        return hull


def reading_scale(scene: Scene, voxel_size: float) -> float:
    """Scale at which photographs are read for voxels of a size in world units: 1, a half, a third, ...

    Smaller pixels do not make voxels say more, nor do voxels below a few pixels make the photographs.
    """
    return 1 / max(1, round(voxel_size / (_FINEST * scene.pixel_footprint)))


@dataclass(frozen=True)
class _Matcher:
    """Finds depths by correlation."""

    scene: Scene
    volume: CarvingVolume
    views: PackedViews
    neighbours: list[list[int]]
    min_score: float
    resolution: float
    footprint: float
    """Of a pixel, world units."""

    def depth_maps(self, buffer: ItemBuffer, each: _Round) -> DepthMaps:
        """Confirmed depths, with weights of 0 where there are none."""
        views, cameras, size = self.views, self.views.cameras, self.volume.voxel_size
        grey = np.stack([cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in views.images]).astype(np.float32)
        items = buffer.items[:, :: each.stride, :: each.stride]
        depths = np.zeros(items.shape, np.float32)
        weights = np.zeros(items.shape, np.float32)
        window = Window(each.radius, each.spacing, MIN_DEVIATION)
        extent = self.scene.bounds.extent
        unknown = each.reach == 1 and not all(view.has_silhouette for view in self.scene.views)
        reach = each.reach * float(np.linalg.norm(extent) if unknown else min(extent))
        for n, others in enumerate(self.neighbours):
            rows, columns = np.nonzero(items[n] >= 0)
            voxels = np.column_stack(np.unravel_index(items[n][rows, columns], self.volume.shape))
            centers = self.volume.origin + (voxels + 0.5) * size
            entry = centers @ cameras.projections[n, 2, :3] + cameras.projections[n, 2, 3]
            found, score = np.zeros(len(entry)), np.full(len(entry), -1.0)
            if others:
                compared = Compared.between(grey[n], cameras.at(n), grey[others], cameras.part(others))
                pixels = each.stride * np.column_stack([columns, rows])
                tried = Tried(entry - 1.5 * size, entry + reach, each.step * self.footprint)
                best_depths(compared, window, pixels, tried, found, score)
            good = score > self.min_score
            depths[n, rows[good], columns[good]] = found[good]
            weights[n, rows[good], columns[good]] = score[good] ** 2
        agreements = np.zeros(depths.shape, np.int64)
        maps = DepthMaps(depths, weights, each.stride)
        count_agreements(cameras, maps, 0.75 * self.resolution, agreements)
        confirmed = agreements > 0
        return DepthMaps(np.where(confirmed, depths, 0), np.where(confirmed, weights, 0), each.stride)
