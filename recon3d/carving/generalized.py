"""Generalised voxel colouring: any cameras, exact visibility."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import generate_binary_structure, label

from recon3d.carving.hysteresis import CANDIDATE, Connectivity
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.method import JudgingMethod
from recon3d.carving.observations import judge
from recon3d.carving.observer import Observer, Voxel
from recon3d.carving.start import any_silhouette, hull_distance
from recon3d.carving.visible import color_visible
from recon3d.checks import require_whole
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.errors import EmptyReconstructionError
from recon3d.scene.packed import PackedViews
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import CarvedVolume, Label
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice


@dataclass(frozen=True)
class GeneralizedVoxelColoring(JudgingMethod):
    """Carve what the views that see it do not agree on, until nothing changes; cameras anywhere, exact visibility.

    Starts from the visual hull where there are silhouettes, else from the volume. In a round, the voxels whose visible
    pixels have changed are judged on all pixels that see them now, and those with a degree at or below their low
    threshold are carved, all at once. When no more are, candidates whose connected component of visible voxels
    holds a consistent one stay, the others are carved; and so on until both steps change nothing.

    The result depends neither on the order of the voxels nor on the number of threads.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999; the fuzzy test under it is
    what Barhoumi et al. name as their future work.
    """

    max_rounds: int = 1000
    """Stop after so many rounds, with what is left then."""

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
        """Carve a volume round by round.

        Returns
        -------
        CarvedVolume
            Consistent: the visible voxels that stayed, coloured; hidden: those inside that no pixel sees.

        Raises
        ------
        EmptyReconstructionError : every visible voxel was carved; says what carved how many.
        """
        volume = CarvingVolume.full(volume)
        views = scene.packed
        field = hull_distance(scene, volume) if any_silhouette(scene) else None
        occupied = volume.occupied & (field > 0) if field is not None else volume.occupied.copy()
        hull = CarvedVolume.untouched(volume, field)
        hull.labels[volume.occupied & ~occupied] = Label.BACKGROUND
        started = int(np.count_nonzero(occupied))

        state = _DenseState(hull, occupied, ItemBuffer(views, volume), self.connectivity, observer)
        carve_to_agreement(state, self.test, max_rounds=self.max_rounds, progress=progress)
        if not occupied.any():
            raise all_carved(scene, self.test, started, hull.count_text())
        hull.labels[occupied] = Label.HIDDEN
        color_visible(hull, state.buffer, occupied)
        return hull


class CarvingState(Protocol):
    """Voxels under generalised voxel colouring, by flat numbers (n,) that stay theirs, whatever they are kept in."""

    views: PackedViews
    voxel_size: float

    def advance(self) -> NDArray[np.int64]:
        """Let pixels see past what was carved; the voxels (n,) that some pixel newly sees, ascending."""

    def patches(self, voxels: NDArray[np.int64]) -> Patches:
        """All pixels that see voxels (n,) now."""

    def centers(self, voxels: NDArray[np.int64]) -> NDArray[np.float64]:
        """Middles (n, 3) of voxels (n,) in the world."""

    def note(self, voxels: NDArray[np.int64], patches: Patches, verdict: Verdict) -> None:
        """Keep what the test says of voxels (n,); a later verdict replaces an earlier one."""

    def unsupported(self) -> NDArray[np.int64]:
        """Visible voxels (n,) in components of visible voxels that hold no consistent one."""

    def carve(self, voxels: NDArray[np.int64]) -> None:
        """Empty voxels (n,)."""


def carve_to_agreement(
    state: CarvingState, test: ConsistencyTest, *, max_rounds: int, progress: Progress | None = None
) -> None:
    """Carve what the test rejects, then what nothing consistent supports, until both steps change nothing."""
    for rounds in range(max_rounds):
        changed = state.advance()
        carved = _rejected(state, test, changed) if len(changed) else state.unsupported()
        if progress:
            progress(rounds + 1, max_rounds)
        if not len(changed) and not len(carved):
            break
        state.carve(carved)
    if progress:
        progress(max_rounds, max_rounds)


def _rejected(state: CarvingState, test: ConsistencyTest, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Test voxels on all pixels that see them now, note the verdicts, return those to carve."""
    patches = state.patches(voxels)
    verdict = judge(test, patches, state.centers(voxels), state.voxel_size, state.views)
    state.note(voxels, patches, verdict)
    return voxels[verdict.inconsistent]


def all_carved(scene: Scene, test: ConsistencyTest, started: int, counts: str) -> EmptyReconstructionError:
    """The error that no voxel is left of those that the carving started from."""
    return EmptyReconstructionError(
        f"scene {scene.name}: the test {test!r} carved all {started:,} voxels that the silhouettes left ({counts})"
    )


class _DenseState:
    """Generalised voxel colouring of a dense volume."""

    def __init__(
        self,
        hull: CarvedVolume,
        occupied: NDArray[np.bool_],
        buffer: ItemBuffer,
        connectivity: Connectivity,
        observer: Observer | None,
    ) -> None:
        self.hull, self.occupied, self.buffer, self.observer = hull, occupied, buffer, observer
        self.patches = buffer.patches
        self.views, self.voxel_size = buffer.views, hull.volume.voxel_size
        self.consistent = np.zeros(occupied.size, np.bool_)
        self.structure = generate_binary_structure(3, {6: 1, 18: 2, 26: 3}[connectivity])

    def advance(self) -> NDArray[np.int64]:
        return self.buffer.advance(self.occupied)

    def indices(self, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.stack(np.unravel_index(voxels, self.occupied.shape), axis=1)

    def centers(self, voxels: NDArray[np.int64]) -> NDArray[np.float64]:
        return self.hull.lattice.centers(self.indices(voxels))

    def note(self, voxels: NDArray[np.int64], patches: Patches, verdict: Verdict) -> None:
        self.hull.degree.ravel()[voxels] = verdict.degree
        self.hull.n_views.ravel()[voxels] = patches.n_views
        self.consistent[voxels] = verdict.consistent
        if self.observer:
            self.observer.judged(self.indices(voxels), patches, verdict, self._seeing)

    def _seeing(self, voxel: Voxel) -> NDArray[np.bool_]:
        return np.asarray(self.buffer.items == np.ravel_multi_index(voxel, self.occupied.shape))

    def unsupported(self) -> NDArray[np.int64]:
        visible = self.buffer.visible()
        if self.observer:
            labels = self.hull.labels.copy()
            labels.ravel()[visible] = CANDIDATE
            labels.ravel()[visible[self.consistent[visible]]] = Label.CONSISTENT
            self.observer.resolving(labels)
        surface = np.zeros(self.occupied.shape, np.bool_)
        surface.ravel()[visible] = True
        component, n = label(surface, self.structure)
        supported = np.zeros(n + 1, np.bool_)
        supported[component.ravel()[visible[self.consistent[visible]]]] = True
        return np.asarray(visible[~supported[component.ravel()[visible]]])

    def carve(self, voxels: NDArray[np.int64]) -> None:
        self.occupied.ravel()[voxels] = False
        self.hull.labels.ravel()[voxels] = Label.INCONSISTENT
