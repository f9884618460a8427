"""Whether matches agree with cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.matches import Matches


class Cameras(NamedTuple):
    """Cameras as arrays, which hypotheses change."""

    K: NDArray[np.float64]
    """(n, 3, 3) with a last row 0 0 1, but perhaps turned or mirrored."""
    poses: NDArray[np.float64]
    """(n, 4, 4) cam_from_world."""
    sizes: NDArray[np.float64]
    """(n, 2) width and height, pixels."""
    reduced: NDArray[np.float64]
    """(n, 3, 3) takes pixels to those of the reduced photographs."""


@dataclass(frozen=True)
class Agreement:
    """How well matches agree with cameras, pair by pair."""

    errors: NDArray[np.float64]
    """(n_pairs,) median distance of a match from its epipolar lines, the mean of both, reduced pixels."""
    before: NDArray[np.float64]
    """(n_pairs,) share of the matches that are triangulated in front of both cameras."""

    @property
    def good(self) -> NDArray[np.bool_]:
        """(n_pairs,) which pairs agree."""
        return (self.errors < GOOD) & (self.before > BEFORE)

    @property
    def error(self) -> float:
        """Of the median pair."""
        return float(np.median(self.errors))

    @property
    def average(self) -> float:
        """Of all pairs; what is quite wrong counts the same."""
        return float(np.minimum(self.errors, 30.0).mean())

    @property
    def in_front(self) -> float:
        """Of the median pair."""
        return float(np.median(self.before))


GOOD = 2.0
"""Reduced pixels up to which a pair's median match agrees with its epipolar lines."""

BEFORE = 0.7
"""Share of a pair's matches that must lie in front of both cameras."""

_FAR = 1e3  # times the baseline; a depth beyond has no sign


def agreement(matches: Matches, cameras: Cameras) -> Agreement:
    """Distances from the epipolar lines of all matches, and on which side of the cameras their points lie."""
    M, p = _projections(cameras)
    back = np.linalg.inv(M)
    a, b = matches.pairs.T
    x = np.concatenate([matches.places, np.ones((*matches.places.shape[:2], 1))], axis=2)
    of = matches.pair
    value, *across = _algebraic(matches, cameras)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = 0.5 * sum(np.abs(value) / length for length in across)
    distance = np.nan_to_num(distance, nan=1e6, posinf=1e6)

    centers = -np.einsum("nij,nj->ni", back, p)
    rays = np.stack([np.einsum("nij,nj->ni", back[side[of]], x[:, k]) for k, side in enumerate((a, b))], axis=1)
    depths = closest_depths(rays, centers[b[of]] - centers[a[of]])
    # Rays have depth one; a camera of positive focal length sees what has a positive one.
    before = np.asarray((depths > 0).all(axis=1))
    starts = np.searchsorted(of, np.arange(len(a)))
    parts = [slice(start, stop) for start, stop in zip(starts, [*starts[1:], len(of)], strict=True)]
    return Agreement(
        np.array([np.median(distance[part]) for part in parts]), np.array([before[part].mean() for part in parts])
    )


def sampson_distances(matches: Matches, cameras: Cameras) -> NDArray[np.float64]:
    """(n,) signed distances of matches from their epipolar lines, to first order, reduced pixels.

    References
    ----------
    Hartley, Zisserman, "Multiple View Geometry in Computer Vision", 2004, equation 11.9.
    """
    value, length_a, length_b = _algebraic(matches, cameras)
    return value / np.maximum(np.hypot(length_a, length_b), 1e-300)


def _algebraic(
    matches: Matches, cameras: Cameras
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(n,) x' F x of each match, and the lengths of the normals of its epipolar lines in both photographs."""
    M, p = _projections(cameras)
    a, b = matches.pairs.T
    H = M[b] @ np.linalg.inv(M)[a]
    e = p[b] - np.einsum("nij,nj->ni", H, p[a])
    F = np.cross(e[:, None, :], H.transpose(0, 2, 1)).transpose(0, 2, 1)  # [e]x H, column by column
    x = np.concatenate([matches.places, np.ones((*matches.places.shape[:2], 1))], axis=2)
    of = matches.pair
    lines_b, lines_a = np.einsum("nij,nj->ni", F[of], x[:, 0]), np.einsum("nij,ni->nj", F[of], x[:, 1])
    value = np.einsum("ni,ni->n", x[:, 1], lines_b)
    return value, np.linalg.norm(lines_a[:, :2], axis=1), np.linalg.norm(lines_b[:, :2], axis=1)


def _projections(cameras: Cameras) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The left part (n, 3, 3) and the last column (n, 3) of the matrices that take the world to reduced pixels."""
    K = cameras.reduced @ cameras.K
    return K @ cameras.poses[:, :3, :3], np.einsum("nij,nj->ni", K, cameras.poses[:, :3, 3])


def closest_depths(rays: NDArray[np.float64], baseline: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) multiples of two rays (n, 2, 3) where they come closest, the second one starting at a baseline (n, 3)."""
    u, v = rays[:, 0], rays[:, 1]
    uu, vv, uv = (np.einsum("ni,ni->n", s, t) for s, t in ((u, u), (v, v), (u, v)))
    ub, vb = np.einsum("ni,ni->n", u, baseline), np.einsum("ni,ni->n", v, baseline)
    determinant = np.maximum(uu * vv - uv * uv, 1e-15 * uu * vv)
    return np.stack([(ub * vv - uv * vb) / determinant, (uv * ub - uu * vb) / determinant], axis=1)


def triangulated(matches: Matches, cameras: Cameras) -> NDArray[np.float64]:
    """(n, 3) middle between the two rays of each match where they come closest, world."""
    M, p = _projections(cameras)
    back = np.linalg.inv(M)
    centers = -np.einsum("nij,nj->ni", back, p)
    x = np.concatenate([matches.places, np.ones((*matches.places.shape[:2], 1))], axis=2)
    sides = matches.pairs[matches.pair]
    rays = np.einsum("nkij,nkj->nki", back[sides], x)
    starts = centers[sides]
    depths = closest_depths(rays, starts[:, 1] - starts[:, 0])
    return np.asarray((starts + depths[..., None] * rays).mean(axis=1))
