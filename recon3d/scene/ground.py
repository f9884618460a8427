"""The table or the ground that an object stands on, found among sparse points.

References
----------
D. Myatt, P. Torr, S. Nasuto, J. Bishop, R. Craddock, "NAPSAC: high noise, high dimensional robust estimation - it's in
the bag", BMVC 2002 (samples of neighbouring points).
O. Chum, J. Matas, J. Kittler, "Locally optimized RANSAC", DAGM 2003.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.scene.view import View

TABLE_LEFT_OUT = "table left out"
"""In words on a box that is of what stands on a plane."""

_SAMPLES = 1500  # of three neighbouring points
_NEIGHBOURS = 48
_MOST = 12000  # points that planes are fitted to
_TRIED = 30  # planes, the likeliest first
_ALIKE = 0.997  # cosine between the normals of planes of which one is tried
_THICKNESS, _THINNEST = 0.012, 0.001  # of the cameras' distance: the least that a point is off the plane
_DEVIATIONS = 3.5  # standard deviations of the plane's points that are as much
_ABOVE = 0.95  # of the cameras
_UPRIGHT = 0.25  # cosine between the plane's normal and where the photographs' upper sides point
_AGREEING_UPS = 0.3  # length of the mean of those directions from which on they tell something
_CLOSE = 0.15  # of the cameras' distance: points farther from where the cameras look weigh less than half
_WIDER = 1.3  # times as far as what stands on it the plane's points reach
_NARROWING = (1, 1, 0.7, 0.5, 0.35, 0.25)  # of the thickness, in which planes are fitted one after the other
_FEWEST, _SHARE = 40, 0.03  # points of the plane, and their share of all
_STANDING = 30  # points, at least, of what stands on it
_BELOW = 0.05  # of the plane's points: as many may lie beneath its area, which a table hides
_EDGE = 1  # percent of the points at each end that an area is measured without


@dataclass(frozen=True)
class SupportingPlane:
    """A plane with an object on it; its normal points to the object."""

    normal: NDArray[np.float64]
    """(3,) unit vector, world."""
    level: float
    """The plane's points x have normal @ x = level, world units."""
    thickness: float
    """World units above and below within which points are the plane's."""
    points: NDArray[np.bool_] = field(repr=False)
    """(n,) which of the points that it was found among are the plane's, or lie below it."""

    def heights(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of points (n, 3) above the plane, world units."""
        return np.asarray(points @ self.normal - self.level)

    def feet(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) points on the plane below points (n, 3), world."""
        return np.asarray(points - self.heights(points)[:, None] * self.normal)


def supporting_plane(
    points: NDArray[np.float64], views: Sequence[View], middle: NDArray[np.float64], reach: float
) -> SupportingPlane | None:
    """The plane that most points lie on and that something stands on, or None.

    All cameras are above it, and their photographs' upper sides, where these agree, point upwards from it: so it is no
    wall. It reaches farther than what stands on it, and below the area that its own points cover there are none, as a
    table hides what is under it: so it is no cut through an object, nor its upper side. Of several it is the one with
    most points close to where the cameras look: the table, not the floor below it.

    Parameters
    ----------
    points : (n, 3) of what the photographs show, world.
    middle : (3,) where the cameras look, world.
    reach : distance from there, along each axis, within which points are looked at, world units.
    """
    counts = np.sum([view.sees(points) for view in views], axis=0)
    asked = points[(np.abs(points - middle).max(axis=1) < reach) & (counts >= 2)]
    if len(asked) < _FEWEST + _STANDING:
        return None
    centers = np.array([view.center for view in views])
    distance = float(np.median(np.linalg.norm(centers - middle, axis=1)))
    # In units of the cameras' distance, from where they look: any world is alike.
    some, seats = (asked[:: 1 + len(asked) // _MOST] - middle) / distance, (centers - middle) / distance
    up = _mean_up(views)
    normals, levels = _candidates(some, seats, up)
    best, highest = None, 0.0
    for _ in range(_TRIED):
        if not len(normals):
            break
        fitted = _fitted(some, normals[0], levels[0])
        if fitted is not None and _is_below(fitted[0][None], fitted[1], seats, up)[0] and _supports(some, *fitted):
            score = _score(some, _weights(some), *fitted)
            best, highest = (fitted, score) if score > highest else (best, highest)
        others = (normals @ normals[0] < _ALIKE) | (np.abs(levels - levels[0]) > _THICKNESS)
        normals, levels = normals[others], levels[others]
    if best is None:
        return None
    normal, level, thickness = best[0], best[1] * distance + float(best[0] @ middle), best[2] * distance
    return SupportingPlane(normal, level, thickness, points @ normal - level < thickness)


def _mean_up(views: Sequence[View]) -> NDArray[np.float64]:
    """(3,) where the photographs' upper sides point, world; zero where they do not agree."""
    mean = -np.mean([view.cam_from_world[1, :3] for view in views], axis=0)
    length = float(np.linalg.norm(mean))
    return np.asarray(mean / length if length > _AGREEING_UPS else np.zeros(3))


def _candidates(
    points: NDArray[np.float64], centers: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals (n, 3) and levels (n,) of planes below the cameras, the likeliest first."""
    random = np.random.default_rng(0)
    first = random.integers(len(points), size=_SAMPLES)
    near = cKDTree(points).query(points[first], k=min(_NEIGHBOURS, len(points)))[1]
    others = np.take_along_axis(near, random.integers(1, near.shape[1], size=(_SAMPLES, 2)), axis=1)
    corner = points[first]
    normals = np.cross(points[others[:, 0]] - corner, points[others[:, 1]] - corner)
    lengths = np.linalg.norm(normals, axis=1)
    usable = lengths > 0
    normals, corner = normals[usable] / lengths[usable, None], corner[usable]
    levels = (normals * corner).sum(axis=1)
    sides = np.sign(np.median(normals @ centers.T - levels[:, None], axis=1))
    normals, levels = normals * sides[:, None], levels * sides
    allowed = _is_below(normals, levels, centers, up)
    normals, levels = normals[allowed], levels[allowed]
    weights = _weights(points)
    scores = np.array([_score(points, weights, *plane) for plane in zip(normals, levels, strict=True)])
    order = np.argsort(-scores, kind="stable")
    return normals[order], levels[order]


def _is_below(
    normals: NDArray[np.float64],
    levels: NDArray[np.float64] | float,
    centers: NDArray[np.float64],
    up: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(n,) which planes are below the cameras, and not upright."""
    below = (normals @ centers.T > np.reshape(levels, (-1, 1))).mean(axis=1) >= _ABOVE
    return np.asarray(below & (normals @ up >= (_UPRIGHT if up.any() else -1)))


def _score(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    normal: NDArray[np.float64],
    level: float,
    thickness: float = _THICKNESS,
) -> float:
    """Weight of the points on a plane, less that of as thick a layer above, and twice that below its area's middle.

    A cut through an object has about as many points above as on it.
    """
    heights = points @ normal - level
    near, under = np.abs(heights) < thickness, heights < -2 * _THICKNESS
    own, below = points[near], points[under]
    middle = own.mean(axis=0)
    hidden = _squared_off_axis(below - middle, normal) < np.median(_squared_off_axis(own - middle, normal))
    above = (heights > thickness) & (heights < 3 * thickness)
    return float(weights[near].sum() - weights[above].sum() - 2 * weights[under][hidden].sum())


def _weights(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) in [0, 1], the more the closer to where the cameras look."""
    return np.asarray(1 / (1 + (points**2).sum(axis=1) / _CLOSE**2))


def _squared_off_axis(offsets: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) squared distances of offsets (n, 3) from a line along a unit vector (3,)."""
    return np.asarray((offsets**2).sum(axis=1) - (offsets @ axis) ** 2)


def _fitted(
    points: NDArray[np.float64], normal: NDArray[np.float64], level: float
) -> tuple[NDArray[np.float64], float, float] | None:
    """Normal (3,), level and thickness of a plane fitted to the points near it, again and again; None: to too few."""
    thickness = _THICKNESS
    for narrowing in (*_NARROWING, None):
        if narrowing is None:  # the densest layer is found: how thick it is
            off = np.abs(points @ normal - level)
            deviation = 1.4826 * float(np.median(off[off < _THICKNESS]))
            thickness = float(np.clip(_DEVIATIONS * deviation, _THINNEST, _THICKNESS))
        else:
            thickness = narrowing * _THICKNESS
        near = points[np.abs(points @ normal - level) < thickness]
        if len(near) < _FEWEST:
            break
        mean = near.mean(axis=0)
        fitted = np.linalg.svd(near - mean, full_matrices=False)[2][2]
        normal = fitted if fitted @ normal > 0 else -fitted
        level = float(normal @ mean)
    if np.count_nonzero(np.abs(points @ normal - level) < thickness) < max(_FEWEST, _SHARE * len(points)):
        return None
    return normal, level, thickness


def _supports(points: NDArray[np.float64], normal: NDArray[np.float64], level: float, thickness: float) -> bool:
    """Whether something stands on a plane's area, and nothing is seen below it."""
    heights = points @ normal - level
    x = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    x /= np.linalg.norm(x)
    flat = (points @ np.stack([x, np.cross(normal, x)]).T).astype(np.float32)
    own = flat[np.abs(heights) < thickness]
    low, high = np.percentile(own, [_EDGE, 100 - _EDGE], axis=0)
    area = cv2.convexHull(own[((own >= low) & (own <= high)).all(axis=1)])
    on, under = np.abs(heights) < thickness, heights < -2 * thickness
    above, below, weights = flat[heights > thickness], flat[under], _weights(points)
    if len(above) < _STANDING or weights[under].sum() > weights[on].sum():
        return False
    foot = np.median(above, axis=0)
    reached, held = (np.linalg.norm(each - foot, axis=1) for each in (own, above))
    if np.percentile(reached, 90) < _WIDER * np.percentile(held, 75) or not _within(area, foot[None], margin=0.1)[0]:
        return False
    return int(_within(area, below).sum()) <= _BELOW * len(own)


def _within(area: NDArray[np.float32], flat: NDArray[np.float32], margin: float = 0.0) -> NDArray[np.bool_]:
    """(n,) which of flat points (n, 2) lie in a convex area, or closer to it than a margin."""
    return np.array(
        [cv2.pointPolygonTest(area, (float(u), float(v)), True) >= -margin for u, v in flat], np.bool_
    ).reshape(len(flat))
