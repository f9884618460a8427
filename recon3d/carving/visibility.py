"""The ordinal visibility constraint: all cameras on one side of a plane, the volume on the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from recon3d.errors import VisibilityError
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene

_BLOCK = 10_000  # pairs of limits that are tried at once
_STEP = 1e-4  # how far, in radians, candidate directions stand off the edges between cells


@dataclass(frozen=True)
class SweepDirection:
    """Unit direction in which every camera lies before every corner of the volume."""

    direction: NDArray[np.float64]
    """(3,) world, from the cameras to the volume."""
    margin: float
    """Width of the empty slab between the cameras and the volume, world units."""


def sweep_direction(centers: NDArray[np.float64], corners: NDArray[np.float64]) -> SweepDirection | None:
    """Direction d with the widest gap between cameras (n, 3) and volume corners (8, 3), or None where there is none.

    The least distance problem "minimise |x| subject to x . (corner - centre) >= 1" by non-negative least squares;
    its solution is the widest margin in the Euclidean sense, so it turns with the world.

    References
    ----------
    Seitz, Dyer, "Photorealistic scene reconstruction by voxel coloring", 1999, section 3 (the constraint).
    Lawson, Hanson, "Solving least squares problems", 1974, chapter 23 (least distance programming).
    """
    differences = (corners[None] - centers[:, None]).reshape(-1, 3)
    scale = np.abs(differences).max()
    system = np.vstack([differences.T / scale, np.ones(len(differences))])
    target = np.array([0.0, 0.0, 0.0, 1.0])
    weights, _ = nnls(system, target)
    residual = system @ weights - target
    if -residual[3] < 1e-12:
        return None
    x = -residual[:3] / residual[3]
    direction = x / np.linalg.norm(x)
    margin = float((differences @ direction).min())
    return SweepDirection(direction, margin) if margin > 1e-9 * scale else None


def spread_views(scene: Scene, count: int) -> Scene:
    """At most so many views of a scene: leaves out, one by one, the view whose camera is nearest to another's."""
    centers = scene.centers
    gaps = np.array([np.linalg.norm(centers - center, axis=1) for center in centers])
    np.fill_diagonal(gaps, np.inf)
    kept, nearest = np.ones(len(centers), np.bool_), gaps.min(axis=1)
    for _ in range(len(centers) - max(count, 1)):
        dropped = int(nearest.argmin())
        kept[dropped] = False
        orphans = kept & (gaps[dropped] == nearest)
        gaps[:, dropped] = np.inf
        nearest[orphans] = gaps[orphans].min(axis=1)
        nearest[dropped] = np.inf
    return replace(scene, views=tuple(scene.views[n] for n in np.flatnonzero(kept)))


def largest_admissible_views(scene: Scene) -> list[str]:
    """Names of the largest subset of views that satisfies the ordinal visibility constraint, in scene order.

    Every set of cameras that some direction separates from the volume contains a direction next to the crossing of
    two limits (planes through the origin normal to corner - centre), so trying those finds the largest. Among equal
    ones the widest margin wins.

    Raises
    ------
    VisibilityError : no view is admissible: every camera is inside or too near the volume.
    """
    corners = scene.bounds.corners
    centers = scene.centers
    best, widest = np.zeros(len(centers), np.bool_), 0.0
    for candidates in _candidate_directions(centers, corners):
        nearest = (corners @ candidates.T).min(axis=0)
        admitted = centers @ candidates.T < nearest
        counts = admitted.sum(axis=0)
        for count in range(int(counts.max()), max(int(best.sum()), 1) - 1, -1):
            for subset in np.unique(admitted[:, counts == count].T, axis=0):
                found = sweep_direction(centers[subset], corners)
                if found and (count > best.sum() or found.margin > widest):
                    best, widest = subset, found.margin
            if best.sum() == count:
                break
    if not best.any():
        raise VisibilityError(f"scene {scene.name}: no single view satisfies the ordinal visibility constraint")
    return [scene.views[n].name for n in np.flatnonzero(best)]


def require_sweep_direction(scene: Scene, bounds: Bounds) -> SweepDirection:
    """Sweep direction of a scene's cameras into a box, or an error that names the views to leave out."""
    found = sweep_direction(scene.centers, bounds.corners)
    if found is None:
        kept = largest_admissible_views(replace(scene, bounds=bounds))
        offending = [view.name for view in scene.views if view.name not in kept]
        raise VisibilityError(
            f"scene {scene.name}: the cameras do not lie on one side of a plane (ordinal visibility constraint). "
            f"{len(kept)} of {len(scene.views)} views can be used together; leave out {', '.join(offending)}, "
            "or let largest_admissible_views(scene) choose"
        )
    return found


def _candidate_directions(centers: NDArray[np.float64], corners: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Directions (n, 3) beside the crossings of every two limits, on all sides of each crossing, block by block."""
    limits = (corners[None] - centers[:, None]).reshape(-1, 3)
    limits /= np.linalg.norm(limits, axis=1, keepdims=True)
    yield limits
    pairs = np.triu_indices(len(limits), 1)
    for block in range(0, len(pairs[0]), _BLOCK):
        a, b = (limits[side[block : block + _BLOCK]] for side in pairs)
        crossings = np.cross(a, b)
        length = np.linalg.norm(crossings, axis=1)
        real = length > 1e-9
        a, b, crossings = a[real], b[real], crossings[real] / length[real, None]
        signs = product((1, -1), repeat=3)
        yield np.vstack([sign * crossings + _STEP * (s * a + t * b) for sign, s, t in signs])
