"""What every view shows of one voxel, and which silhouettes exclude it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.observer import Voxel, VoxelWatcher
from recon3d.carving.start import silhouette_outlines
from recon3d.consistency.fuzzy import LUMINANCE
from recon3d.kernels.footprints import footprint
from recon3d.kernels.silhouettes import Outlines, distance_in
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.volume.carved import CarvedVolume, Label


class PixelKind(IntEnum):
    """What a pixel of a voxel's box was when the voxel was judged."""

    BACKGROUND = 0
    """Outside the silhouette."""
    FOREGROUND = 1
    """May show the object; nobody asked it about the voxel."""
    TAKEN = 2
    """Foreground that showed something else by then: claimed before, or seeing another voxel."""
    VOTED = 3
    """Foreground that showed the voxel."""


@dataclass(frozen=True)
class ViewEvidence:
    """What one view shows of a voxel."""

    name: str
    """The view's."""
    image: NDArray[np.uint8]
    """(height, width, 3) RGB, the whole photograph."""
    box: tuple[int, int, int, int]
    """B_j(v): first and last column u, first and last row v; a last one before its first: not seen."""
    kinds: NDArray[np.uint8]
    """(rows, columns) ``PixelKind`` of the pixels in the box, as they were when the voxel was last judged."""
    excludes: str = ""
    """By how much the view's silhouette excludes the voxel; empty: it does not."""

    @property
    def sees(self) -> bool:
        """Whether any of the box lies in the image, before the camera."""
        return bool(self.kinds.size)

    @property
    def colors(self) -> NDArray[np.uint8]:
        """(n, 3) RGB of the pixels that voted, row by row."""
        u0, u1, v0, v1 = self.box
        return np.asarray(self.image[v0 : v1 + 1, u0 : u1 + 1][self.kinds == PixelKind.VOTED])

    @property
    def luminances(self) -> NDArray[np.int64]:
        """(n,) 8-bit luminances of the pixels that voted."""
        return np.asarray((self.colors @ LUMINANCE + 500) // 1000)

    def count(self, kind: PixelKind) -> int:
        """Pixels of a kind."""
        return int(np.count_nonzero(self.kinds == kind))


def view_evidence(
    scene: Scene, views: PackedViews, hull: CarvedVolume, watcher: VoxelWatcher, *, asks: bool
) -> tuple[ViewEvidence, ...]:
    """What every view of a scene shows of a watched voxel; of a judged one, what it showed then."""
    excluding = Silhouettes(scene, views, hull).excluding(watcher.voxel)
    # A voxel that was visited and not judged had lost all its pixels before.
    visited = watcher.judgements or (asks and hull.labels[watcher.voxel] == Label.HIDDEN)
    others = PixelKind.TAKEN if visited else PixelKind.FOREGROUND
    evidence = []
    for n, view in enumerate(scene.views):
        u0, u1, v0, v1 = (int(x) for x in watcher.boxes[n])
        foreground = views.foreground[n, v0 : v1 + 1, u0 : u1 + 1]
        kinds = np.where(foreground, others, PixelKind.BACKGROUND).astype(np.uint8)
        if watcher.judgements:
            kinds[watcher.judgements[-1].votes[n]] = PixelKind.VOTED
        evidence.append(ViewEvidence(view.name, view.image, (u0, u1, v0, v1), kinds, excluding[n]))
    return tuple(evidence)


class Silhouettes:
    """Which views exclude voxels, by the same rule as the engine that made a hull."""

    def __init__(self, scene: Scene, views: PackedViews, hull: CarvedVolume) -> None:
        self.scene, self.views, self.volume = scene, views, hull.volume
        self.outlines = silhouette_outlines(scene) if hull.distance is not None else None

    def excluding(self, voxel: Voxel) -> list[str]:
        """View by view how far it excludes a voxel; empty where it does not."""
        return self._by_footprints(voxel) if self.outlines is None else self._by_centers(voxel, self.outlines)

    def _by_centers(self, voxel: Voxel, outlines: Outlines) -> list[str]:
        """Where hulls have distances: a voxel's centre must lie inside the outline."""
        center = tuple(self.volume.lattice.centers(np.array(voxel)))
        texts = []
        known = 0  # outlines are of the views with a silhouette
        for view in self.scene.views:
            inside = np.inf
            if view.has_silhouette:
                inside = distance_in(outlines, known, center)
                known += 1
            outside = self.scene.length(-inside, digits=2)
            texts.append(f"its centre lies {outside} outside" if inside <= 0 else "")
        return texts

    def _by_footprints(self, voxel: Voxel) -> list[str]:
        """Elsewhere: its footprint, if wholly in the image, must hold foreground."""
        views, size = self.views, self.volume.voxel_size
        corner = tuple(self.volume.origin + np.array(voxel) * size)
        texts = []
        for n in range(len(views)):
            u0, u1, v0, v1, whole = footprint(views.cameras, n, corner, size)
            box = views.foreground[n, v0 : v1 + 1, u0 : u1 + 1]
            texts.append(f"all {box.size} pixels are background" if whole and not box.any() else "")
        return texts
