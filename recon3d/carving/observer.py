"""What becomes of one voxel while an engine runs: every judgement of it, and what the hysteresis decided."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recon3d.carving.hysteresis import CANDIDATE
from recon3d.consistency.base import Patches, Verdict
from recon3d.volume.carved import Label

Voxel = tuple[int, int, int]


Shown = Callable[[Voxel], NDArray[np.bool_]]
"""From a voxel just judged to the pixels (n_views, height, width) that could show it then, in its boxes and beyond."""


class Observer(Protocol):
    """Receives verdicts as they are made; must not change them."""

    def judged(self, voxels: NDArray[np.int64], patches: Patches, verdict: Verdict, shown: Shown) -> None:
        """A batch of voxels (n, 3) has been judged."""

    def resolving(self, labels: NDArray[np.uint8]) -> None:
        """Candidates are about to be resolved: labels (nx, ny, nz) with ``CONSISTENT`` and ``CANDIDATE`` voxels."""


@dataclass(frozen=True)
class Judgement:
    """One verdict on a voxel, the pixels it was given on, and what the hysteresis made of it."""

    degree: float
    low: float
    high: float
    votes: tuple[NDArray[np.bool_], ...]
    """View by view, which pixels of the voxel's box B_j(v) (rows, columns) voted; empty: the view does not see it."""
    path: tuple[Voxel, ...] = ()
    """For a candidate that was resolved: from it through candidates to a consistent voxel; ends with a candidate where
    there is none."""
    n_connected: int = 0
    """Candidates, itself included, that candidates connect it to; 0: it was no candidate, or not resolved."""

    @property
    def n_views(self) -> int:
        """N(v), views with a vote (eq. 6)."""
        return sum(bool(votes.any()) for votes in self.votes)

    @property
    def is_candidate(self) -> bool:
        """Whether the degree lies between the thresholds."""
        return self.low < self.degree < self.high

    @property
    def connected(self) -> bool:
        """Whether candidates connect this one to a consistent voxel."""
        return len(self.path) > 1


class VoxelWatcher:
    """An observer of one voxel."""

    def __init__(self, voxel: Voxel, boxes: NDArray[np.int32], offsets: NDArray[np.int64]) -> None:
        """Watch a voxel with boxes (n_views, 4) of pixels u0, u1, v0, v1, and steps (n, 3) to its neighbours."""
        self.voxel, self.boxes, self.offsets = voxel, boxes, offsets
        self.judgements: list[Judgement] = []

    def judged(self, voxels: NDArray[np.int64], patches: Patches, verdict: Verdict, shown: Shown) -> None:
        """Keep the verdict on the voxel, where it is in the batch (n, 3)."""
        for n in np.flatnonzero((voxels == self.voxel).all(axis=1)):
            pixels = shown(self.voxel)
            votes = tuple(
                pixels[view, v0 : v1 + 1, u0 : u1 + 1] & (patches.counts[n, view] > 0)
                for view, (u0, u1, v0, v1) in enumerate(self.boxes)
            )
            degree, low, high = float(verdict.degree[n]), float(verdict.low[n]), float(verdict.high[n])
            self.judgements.append(Judgement(degree, low, high, votes))

    def resolving(self, labels: NDArray[np.uint8]) -> None:
        """Keep how the voxel, where it is a candidate by the labels (nx, ny, nz), is connected."""
        if labels[self.voxel] == CANDIDATE:
            path, n_connected = path_to_consistent(labels, self.voxel, self.offsets)
            self.judgements[-1] = replace(self.judgements[-1], path=path, n_connected=n_connected)


def path_to_consistent(
    labels: NDArray[np.uint8], voxel: Voxel, offsets: NDArray[np.int64]
) -> tuple[tuple[Voxel, ...], int]:
    """Shortest way from a candidate through candidates to a consistent voxel, and how many candidates were met.

    By the labels (nx, ny, nz), in index steps (n, 3).
    """
    steps = [tuple(int(x) for x in step) for step in offsets]
    before: dict[Voxel, Voxel | None] = {voxel: None}
    queue = deque([voxel])
    while queue:
        at = queue.popleft()
        for step in steps:
            i, j, k = (a + b for a, b in zip(at, step, strict=True))
            inside = 0 <= i < labels.shape[0] and 0 <= j < labels.shape[1] and 0 <= k < labels.shape[2]
            if not inside or (i, j, k) in before or labels[i, j, k] not in (CANDIDATE, Label.CONSISTENT):
                continue
            before[i, j, k] = at
            if labels[i, j, k] == Label.CONSISTENT:
                return _way_back((i, j, k), before), len(before) - 1
            queue.append((i, j, k))
    return (voxel,), len(before)


def _way_back(end: Voxel, before: dict[Voxel, Voxel | None]) -> tuple[Voxel, ...]:
    """The way that led to a voxel, from its start."""
    path: list[Voxel] = []
    at: Voxel | None = end
    while at is not None:
        path.append(at)
        at = before[at]
    return tuple(reversed(path))


def voxel_text(voxel: Voxel) -> str:
    """A voxel's index as text."""
    return f"({', '.join(map(str, voxel))})"
