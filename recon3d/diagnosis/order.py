"""Which photograph belongs to which camera, found by matches where they are in different orders.

Two photographs that match have an epipolar geometry, and only some pairs of cameras have that one. From a pair of
photographs and a pair of cameras that fit, the others are assigned one after the other, each to the camera that agrees
best with its matches to those that have one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.epipolar import BEFORE, GOOD, Cameras, agreement
from recon3d.diagnosis.matches import Matches

_MATCHES = 12  # of a pair of photographs that are looked at, evenly chosen
_SEEDS = 60  # pairs of cameras that are tried for the first pairs of photographs
_FIRST = 3  # pairs of photographs, of those with the fewest fitting cameras
_WORST = 10.0  # reduced pixels; what is quite wrong counts the same


class _Link(NamedTuple):
    """A photograph's matches with another one."""

    pair: int
    other: int
    first: bool
    """Whether the photograph is the first of the pair."""


def assigned(matches: Matches, cameras: Cameras) -> NDArray[np.int64]:
    """(n,) which photograph's camera each photograph has in the assignment that makes most pairs agree.

    Photographs without matches take what is left. Photographs are of one size.
    """
    n = len(cameras.K)
    costs = _costs(matches, cameras)
    links: list[list[_Link]] = [[] for _ in range(n)]
    for pair, (a, b) in enumerate(matches.pairs):
        links[a].append(_Link(pair, int(b), first=True))
        links[b].append(_Link(pair, int(a), first=False))
    best, fewest = np.arange(n), np.inf
    for pair in np.argsort((costs < GOOD).sum(axis=(1, 2)), kind="stable")[:_FIRST]:
        for place in np.argsort(costs[pair], axis=None, kind="stable")[:_SEEDS]:
            i, j = np.unravel_index(place, (n, n))
            if costs[pair, i, j] >= GOOD:
                break
            order = _spread(
                costs, matches, links, dict(zip(matches.pairs[pair].tolist(), (int(i), int(j)), strict=True))
            )
            total = float(np.minimum(costs[np.arange(len(costs)), *order[matches.pairs].T], _WORST).sum())
            if total < fewest:
                best, fewest = order, total
    return best


def _costs(matches: Matches, cameras: Cameras) -> NDArray[np.float64]:
    """(n_pairs, n, n) distance of the median match of each pair from its epipolar lines, were it of cameras i and j.

    Reduced pixels; infinite where the cameras are the same, or points lie behind them.
    """
    n, n_pairs = len(cameras.K), len(matches.pairs)
    costs = np.full((n_pairs, n, n), np.inf)
    i, j = (index.ravel() for index in np.nonzero(~np.eye(n, dtype=bool)))
    for pair in range(n_pairs):
        places = matches.places[matches.pair == pair]
        places = places[np.unique(np.linspace(0, len(places) - 1, _MATCHES).round().astype(int))]
        tried = Matches(
            np.column_stack([i, j]), np.repeat(np.arange(len(i)), len(places)), np.tile(places, (len(i), 1, 1))
        )
        found = agreement(tried, cameras)
        costs[pair, i, j] = np.where(found.before > BEFORE, found.errors, np.inf)
    return costs


def _spread(
    costs: NDArray[np.float64], matches: Matches, links: Sequence[Sequence[_Link]], known: dict[int, int]
) -> NDArray[np.int64]:
    """(n,) cameras of all photographs, from those of two."""
    n = costs.shape[1]
    free = np.ones(n, np.bool_)
    free[list(known.values())] = False
    while (found := _next(costs, links, known, free) or _next_pair(costs, matches, known, free)) is not None:
        known |= found
        free[list(found.values())] = False
    order = np.full(n, -1, np.int64)
    order[list(known)] = list(known.values())
    own = (order < 0) & free  # without matches they keep their own camera, if it is left
    order[own], free[own] = np.flatnonzero(own), False
    order[order < 0] = np.flatnonzero(free)
    return order


def _next(
    costs: NDArray[np.float64], links: Sequence[Sequence[_Link]], known: dict[int, int], free: NDArray[np.bool_]
) -> dict[int, int] | None:
    """The photograph, of those with matches to one that has a camera, whose best camera fits best, and that camera."""
    best: tuple[float, dict[int, int]] | None = None
    for photograph, own in enumerate(links):
        rows = [
            costs[link.pair, :, known[link.other]] if link.first else costs[link.pair, known[link.other], :]
            for link in own
            if photograph not in known and link.other in known
        ]
        if not rows:
            continue
        mean = np.where(free, np.minimum(np.array(rows), _WORST).mean(axis=0), np.inf)
        camera = int(np.argmin(mean))
        rank = float(mean[camera]) / len(rows)  # the more matched neighbours, the surer
        if best is None or rank < best[0]:
            best = rank, {photograph: camera}
    return None if best is None else best[1]


def _next_pair(
    costs: NDArray[np.float64], matches: Matches, known: dict[int, int], free: NDArray[np.bool_]
) -> dict[int, int] | None:
    """Two matched photographs without cameras and those, of what is left, that fit them best."""
    left = np.flatnonzero(~np.isin(matches.pairs, list(known)).any(axis=1))
    cameras = np.flatnonzero(free)
    if not len(left) or len(cameras) < 2:
        return None
    part = costs[np.ix_(left, cameras, cameras)]
    pair, i, j = (int(k) for k in np.unravel_index(np.argmin(part), part.shape))
    a, b = matches.pairs[left[pair]]
    return {int(a): int(cameras[i]), int(b): int(cameras[j])}
