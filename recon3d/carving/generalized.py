"""Generalised voxel colouring: any cameras, exact visibility."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import generate_binary_structure, label

from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.photo_hull import Label, PhotoHull, Progress
from recon3d.carving.views import ViewArrays
from recon3d.carving.visual_hull import color_visible, hull_distance
from recon3d.carving.voxel_coloring import Connectivity
from recon3d.consistency import ConsistencyTest, FuzzyAdaptiveHysteresis
from recon3d.errors import EmptyReconstructionError
from recon3d.scene import Scene
from recon3d.volume import CarvingVolume


def generalized_voxel_coloring(
    scene: Scene,
    volume: CarvingVolume,
    test: ConsistencyTest | None = None,
    *,
    connectivity: Connectivity = 26,
    max_rounds: int = 1000,
    progress: Progress | None = None,
) -> PhotoHull:
    """Carve what the views that see it do not agree on, until nothing changes.

    Starts from the visual hull where there are silhouettes, else from the volume. In a round, the voxels whose visible
    pixels have changed are judged on all pixels that see them now, and those with a degree at or below their low
    threshold are carved, all at once. When no more are, candidates whose connected component of visible voxels
    holds a consistent one stay, the others are carved; and so on until both steps change nothing.

    The result depends neither on the order of the voxels nor on the number of threads.

    Parameters
    ----------
    test : the photo-consistency test; the paper's fuzzy test when None.
    connectivity : neighbours that carry a candidate: 6 (faces), 18 (edges), 26 (corners).
    max_rounds : stop after so many rounds, with what is left then.

    Returns
    -------
    PhotoHull
        Consistent: the visible voxels that stayed, coloured; hidden: those inside that no pixel sees.

    Raises
    ------
    EmptyReconstructionError : every visible voxel was carved; says what carved how many.

    References
    ----------
    Culbertson, Malzbender, Slabaugh, "Generalized voxel coloring", Vision Algorithms 1999; the fuzzy test under it is
    what Barhoumi et al. name as their future work.
    """
    test = FuzzyAdaptiveHysteresis() if test is None else test
    views = ViewArrays(scene)
    known = any(view.silhouette is not None for view in scene.views)
    field = hull_distance(scene, volume) if known else None
    occupied = volume.occupied & (field > 0) if field is not None else volume.occupied.copy()
    hull = PhotoHull.untouched(volume, field)
    hull.labels[volume.occupied & ~occupied] = Label.BACKGROUND
    started = int(np.count_nonzero(occupied))

    buffer = ItemBuffer(views, volume)
    consistent = np.zeros(occupied.size, np.bool_)
    structure = generate_binary_structure(3, {6: 1, 18: 2, 26: 3}[connectivity])
    for rounds in range(max_rounds):
        changed = buffer.advance(occupied)
        if len(changed):
            carved = _judge(hull, buffer, test, changed, consistent)
        else:
            carved = _unsupported(buffer.visible(), consistent, structure, occupied.shape)
        if progress:
            progress(rounds + 1, max_rounds)
        if not len(changed) and not len(carved):
            break
        occupied.ravel()[carved] = False
        hull.labels.ravel()[carved] = Label.INCONSISTENT

    if not occupied.any():
        raise EmptyReconstructionError(
            f"scene {scene.name}: the test {test!r} carved all {started:,} voxels that the silhouettes left "
            f"({hull.count_text()})"
        )
    hull.labels[occupied] = Label.HIDDEN
    color_visible(hull, buffer, occupied)
    return hull


def _judge(
    hull: PhotoHull,
    buffer: ItemBuffer,
    test: ConsistencyTest,
    voxels: NDArray[np.int64],
    consistent: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Test voxels (flat indices) on all pixels that see them now, note the consistent ones, return those to carve."""
    patches = buffer.patches(voxels)
    verdict = test(patches)
    if len(verdict.degree) != len(voxels):
        raise ValueError(f"{test!r} judged {len(verdict.degree)} voxels of {len(voxels)}")
    hull.degree.ravel()[voxels] = verdict.degree
    hull.n_views.ravel()[voxels] = patches.n_views
    accepted = verdict.degree >= verdict.high
    consistent[voxels] = accepted
    return voxels[~accepted & (verdict.degree <= verdict.low)]


def _unsupported(
    visible: NDArray[np.int64],
    consistent: NDArray[np.bool_],
    structure: NDArray[np.bool_],
    shape: tuple[int, ...],
) -> NDArray[np.int64]:
    """Visible voxels (flat indices) in components of visible voxels that hold no consistent one."""
    surface = np.zeros(shape, np.bool_)
    surface.ravel()[visible] = True
    component, n = label(surface, structure)
    supported = np.zeros(n + 1, np.bool_)
    supported[component.ravel()[visible[consistent[visible]]]] = True
    return np.asarray(visible[~supported[component.ravel()[visible]]])
