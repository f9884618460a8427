"""The ordinal visibility constraint: all cameras on one side of a plane, the volume on the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from recon3d.errors import VisibilityError
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene

_BLOCK = 64  # edges that are walked at once
_CHANCE = 2048  # directions that are tried before the search, so that it can pass over what is not better
_NARROW = 5e-7  # angles, in radians, that are taken for none: sweep_direction wants relative margins above 1e-6
_TIE = 1e-9  # relative difference of margins that are equal


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
    return _widest_gap(centers, corners, 0.0)


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

    The directions that admit a camera form a cone. The directions that admit a largest subset are the common part of
    its cones, which edges of these cones bound: a walk along every edge, counting the other cones that it enters and
    leaves, passes all largest subsets. Among equal ones the widest margin wins, then the one with the earliest views.

    Raises
    ------
    VisibilityError : no view is admissible: every camera is inside or too near the volume.

    References
    ----------
    Johnson, Preparata, "The densest hemisphere problem", 1978 (one limit for each camera, as here within an octant).
    """
    corners, centers = scene.bounds.corners, scene.centers
    best = _chance_subset(centers, corners)
    enough = max(int(best.sum()), 1)
    octants = [_octant(centers, corners, np.array(signs)) for signs in product((1.0, -1.0), repeat=3)]
    peaks = [_peaks(octant, enough) for octant in octants]
    for count in range(max(int(peak.max()) for peak in peaks), enough - 1, -1):
        edges = [np.flatnonzero(peak >= count) for peak in peaks]
        subsets = np.vstack([_subsets(octant, some, count) for octant, some in zip(octants, edges, strict=True)])
        widest = _widest_subset(centers, corners, subsets)
        if widest is not None:
            best = widest
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


def _widest_gap(centers: NDArray[np.float64], corners: NDArray[np.float64], wider_than: float) -> SweepDirection | None:
    """Sweep direction, or None where its margin is not wider; few of the pairs of camera and corner decide it.

    Each round adds the pair that is the nearest along the direction; the margin of the pairs so far bounds the answer.
    """
    middle = corners.mean(axis=0)
    centers, corners = centers - middle, corners - middle
    scale = max((corners.max(axis=0) - centers.min(axis=0)).max(), (centers.max(axis=0) - corners.min(axis=0)).max())
    target = np.array([0.0, 0.0, 0.0, 1.0])
    pairs: list[NDArray[np.float64]] = []
    direction, bound = -centers.mean(axis=0), np.inf
    while True:
        pair = corners[(corners @ direction).argmin()] - centers[(centers @ direction).argmax()]
        margin = float(pair @ direction)
        if margin >= bound - 1e-14 * scale:
            return SweepDirection(direction, margin)
        pairs.append(pair / scale)
        system = np.vstack([np.array(pairs).T, np.ones(len(pairs))])
        residual = system @ nnls(system, target)[0] - target
        if -residual[3] < 1e-12:  # the square of the relative margin
            return None
        direction = residual[:3] / np.linalg.norm(residual[:3])
        bound = scale * float((direction @ system[:3]).min())
        if bound <= wider_than:
            return None


def _widest_subset(
    centers: NDArray[np.float64], corners: NDArray[np.float64], subsets: NDArray[np.bool_]
) -> NDArray[np.bool_] | None:
    """The subset (n,) of views, of several (k, n), that has the widest margin; None: none of them is admissible."""
    widest, found = 0.0, []
    for subset in {subset.tobytes(): subset for subset in subsets}.values():
        gap = _widest_gap(centers[subset], corners, (1 - _TIE) * widest)
        if gap:
            widest = max(widest, gap.margin)
            found.append((gap.margin, subset))
    ties = [subset for margin, subset in found if margin >= (1 - _TIE) * widest]
    return max(ties, key=lambda subset: subset.tobytes(), default=None)


def _chance_subset(centers: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Largest subset (n,) of views that a lattice of directions admits; none where it is not admissible."""
    z = np.linspace(-1, 1, _CHANCE)
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(_CHANCE)
    directions = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    admitted = directions @ centers.T < (directions @ corners.T).min(axis=1)[:, None]
    subset = admitted[admitted.sum(axis=1).argmax()]
    return subset if subset.any() and sweep_direction(centers[subset], corners) else np.zeros_like(subset)


class _Octant(NamedTuple):
    """Directions of one octant: one corner is the nearest in all of them, so each camera has one limit.

    A limit is the plane through the origin normal to corner - centre.
    """

    always: NDArray[np.bool_]
    """(n,) cameras that all of these directions admit."""
    mixed: NDArray[np.int64]
    """(m,) indices of the cameras that some of them admit."""
    limits: NDArray[np.float64]
    """(m, 3) unit normals; directions on their side admit the camera."""
    inward: NDArray[np.float64]
    """(m + 3, 3) unit normals of the edges: where limits cross the octant, and its three sides (a cell may fill it)."""
    starts: NDArray[np.float64]
    """(m + 3, 3) unit directions at one end of each edge."""
    ends: NDArray[np.float64]
    """(m + 3, 3) unit directions at the other end."""


def _octant(centers: NDArray[np.float64], corners: NDArray[np.float64], signs: NDArray[np.float64]) -> _Octant:
    """Limits and edges in the octant of directions with these signs."""
    limits = signs * (corners[(corners @ signs).argmin()] - centers)
    limits /= np.maximum(np.linalg.norm(limits, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    limits[np.abs(limits) < _NARROW] = 0
    before, behind = (limits > 0).any(axis=1), (limits < 0).any(axis=1)
    mixed = np.flatnonzero(before & behind)
    limits = limits[mixed]
    # An edge runs from one side of the octant to another: the two at the axis whose sign is not that of the others.
    positive = limits >= 0
    lone = np.where(positive.sum(axis=1) == 1, positive.argmax(axis=1), (~positive).argmax(axis=1))
    rows, ends = np.arange(len(limits)), []
    for step in (1, 2):
        other = (lone + step) % 3
        end = np.zeros_like(limits)
        end[rows, lone] = np.abs(limits[rows, other])
        end[rows, other] = np.abs(limits[rows, lone])
        ends.append(end / np.linalg.norm(end, axis=1, keepdims=True))
    axes = np.eye(3)
    return _Octant(
        before & ~behind,
        mixed,
        signs * limits,
        signs * np.vstack([limits, axes]),
        signs * np.vstack([ends[0], np.roll(axes, 1, axis=0)]),
        signs * np.vstack([ends[1], np.roll(axes, 2, axis=0)]),
    )


def _peaks(octant: _Octant, enough: int) -> NDArray[np.int64]:
    """Largest number of cameras that is admitted along each edge of an octant; 0 where that is less than enough."""
    peaks = np.zeros(len(octant.starts), np.int64)
    for block in range(0, len(peaks), _BLOCK):
        edges = np.arange(block, min(block + _BLOCK, len(peaks)))
        heights = np.maximum(octant.starts[edges] @ octant.limits.T, octant.ends[edges] @ octant.limits.T)
        admissible = octant.always.sum() + np.count_nonzero(heights > -_NARROW, axis=1)
        edges = edges[admissible >= enough]
        peaks[edges] = _walk(octant, edges).counts.max(axis=1)
    return peaks


def _subsets(octant: _Octant, edges: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """Subsets (k, n) of so many views that are admitted along edges (r,) of an octant."""
    walk = _walk(octant, edges)
    rows, stretches = np.nonzero(walk.counts == count)
    subsets = np.tile(octant.always, (len(rows), 1))
    subsets[:, octant.mixed] = walk.first[rows] ^ (walk.changes[rows] < walk.middles[rows, stretches, None])
    return subsets


class _Walk(NamedTuple):
    """What is admitted just inside edges (r,) of an octant, in the stretches between changes."""

    first: NDArray[np.bool_]
    """(r, m) mixed cameras that are admitted at the start."""
    changes: NDArray[np.float64]
    """(r, m) fraction of the edge at which this changes; 1 where it does not."""
    counts: NDArray[np.int64]
    """(r, m + 1) number of admitted cameras in each stretch; 0 where it is too narrow."""
    middles: NDArray[np.float64]
    """(r, m + 1) middle of each stretch, as a fraction of the edge."""


def _walk(octant: _Octant, edges: NDArray[np.int64]) -> _Walk:
    """Walk along edges, by index, from their starts to their ends."""
    start, end = octant.starts[edges] @ octant.limits.T, octant.ends[edges] @ octant.limits.T
    start[np.abs(start) < _NARROW] = 0
    end[np.abs(end) < _NARROW] = 0
    along = (start == 0) & (end == 0) & (octant.inward[edges] @ octant.limits.T > 0)
    first = (start > 0) | ((start == 0) & (end > 0)) | along
    last = (end > 0) | ((end == 0) & (start > 0)) | along
    changes = np.divide(start, start - end, out=np.ones_like(start), where=first != last)
    order = changes.argsort(axis=1)
    steps = np.take_along_axis(last.astype(np.int64) - first, order, axis=1)
    counts = np.cumsum(np.column_stack([octant.always.sum() + first.sum(axis=1), steps]), axis=1)
    stops = np.pad(np.take_along_axis(changes, order, axis=1), ((0, 0), (1, 1)), constant_values=((0, 0), (0, 1)))
    lengths = np.linalg.norm(octant.ends[edges] - octant.starts[edges], axis=1)
    counts[np.diff(stops, axis=1) * lengths[:, None] < _NARROW] = 0
    return _Walk(first, changes, counts, (stops[:, 1:] + stops[:, :-1]) / 2)
