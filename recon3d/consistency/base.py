"""What a photo-consistency test is given, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError


@dataclass(frozen=True)
class Patches:
    """Pixels that a batch of voxels shows, voxel by voxel, view by view; no voxel is without pixels."""

    colors: NDArray[np.uint8]
    """(n_pixels, 3) RGB."""
    view_starts: NDArray[np.int64]
    """(n_voxels, n_views + 1): pixels of voxel n in view j are ``colors[view_starts[n, j]:view_starts[n, j + 1]]``.

    An empty range: the view does not see the voxel. A voxel's last entry is the next one's first.
    """
    directions: NDArray[np.float32] | None = None
    """(n_voxels, n_views, 3) unit vectors, world frame, from each voxel's centre to the cameras, seeing it or not.

    None unless the test has ``needs_directions = True``.
    """
    windows: NDArray[np.float32] | None = None
    """(n_voxels, n_views, side * side) luminance, 0 to 255, of each view at the points of one small plane, row by row.

    The plane goes through the voxel's centre and faces the views that see it. NaN throughout where a view does not
    see the voxel or does not hold the whole window. None unless the test has ``window_side = side``.
    """

    def __post_init__(self) -> None:
        n_voxels, n_views = self.view_starts.shape[0], self.view_starts.shape[1] - 1
        if self.directions is not None and self.directions.shape != (n_voxels, n_views, 3):
            raise ArgumentError(f"expected directions ({n_voxels}, {n_views}, 3), got {self.directions.shape}")
        if self.windows is not None and self.windows.shape[:-1] != (n_voxels, n_views):
            raise ArgumentError(f"expected windows ({n_voxels}, {n_views}, side * side), got {self.windows.shape}")

    @property
    def n_voxels(self) -> int:
        """Length of the batch."""
        return int(self.view_starts.shape[0])

    @property
    def starts(self) -> NDArray[np.int64]:
        """(n_voxels + 1,) where each voxel's pixels begin, all views together."""
        end = self.view_starts[-1:, -1] if self.n_voxels else np.zeros(1, np.int64)
        return np.concatenate([self.view_starts[:, 0], end])

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n_voxels, n_views) pixels of each voxel in each view."""
        return np.diff(self.view_starts, axis=1)

    @property
    def n_views(self) -> NDArray[np.int64]:
        """(n_voxels,) N(v), the number of views that see each voxel (eq. 6)."""
        return np.asarray(np.count_nonzero(self.counts, axis=1))

    @property
    def voxel_of_pixel(self) -> NDArray[np.int64]:
        """(n_pixels,) voxel that each pixel belongs to, for ``np.bincount`` and the like."""
        return np.repeat(np.arange(self.n_voxels), np.diff(self.starts))

    def part(self, start: int, stop: int) -> Patches:
        """The voxels from start to stop (exclusive), as a batch of their own."""
        bounds = self.starts
        view_starts = self.view_starts[start:stop] - bounds[start]
        return Patches(
            self.colors[bounds[start] : bounds[stop]],
            view_starts,
            None if self.directions is None else self.directions[start:stop],
            None if self.windows is None else self.windows[start:stop],
        )


@dataclass(frozen=True)
class Verdict:
    """Degree of photo-consistency and the two thresholds of the hysteresis, voxel by voxel.

    Consistent at ``degree >= high``; else carved at ``degree <= low``; a candidate between, which stays when
    candidates connect it to a consistent voxel. A test with one threshold has ``low == high``.
    """

    degree: NDArray[np.float64]
    """(n_voxels,) in [0, 1]."""
    low: NDArray[np.float64]
    """(n_voxels,)."""
    high: NDArray[np.float64]
    """(n_voxels,)."""

    def __post_init__(self) -> None:
        if not self.degree.shape == self.low.shape == self.high.shape or self.degree.ndim != 1:
            raise ArgumentError(
                f"expected degree, low and high of one length, got {self.degree.shape}, {self.low.shape}, "
                f"{self.high.shape}"
            )
        if not ((self.degree >= 0) & (self.degree <= 1)).all():
            raise ArgumentError("expected every degree in [0, 1]; a test gave NaN or a number outside")
        if not (self.low <= self.high).all():
            raise ArgumentError("expected low <= high for every voxel")

    @property
    def consistent(self) -> NDArray[np.bool_]:
        """(n_voxels,) accepted at once."""
        return np.asarray(self.degree >= self.high)

    @property
    def inconsistent(self) -> NDArray[np.bool_]:
        """(n_voxels,) carved at once."""
        return np.asarray((self.degree <= self.low) & ~self.consistent)

    @property
    def candidate(self) -> NDArray[np.bool_]:
        """(n_voxels,) for the hysteresis to decide."""
        return np.asarray((self.degree > self.low) & ~self.consistent)


@runtime_checkable
class ConsistencyTest(Protocol):
    """Anything that judges a batch of voxels; plain numpy will do.

    A test that wants more than pixels says so by attributes, which the engines look for: ``needs_directions = True``
    fills ``Patches.directions``, ``window_side = 5`` fills ``Patches.windows`` with 5x5 samples.
    """

    def __call__(self, patches: Patches) -> Verdict:
        """Judge every voxel of the batch from its pixels alone; the batch may be empty."""


class AroundTest:
    """Forwards the wrapped test's requests."""

    test: ConsistencyTest

    @property
    def needs_directions(self) -> bool:
        """Whether the test does."""
        return bool(getattr(self.test, "needs_directions", False))

    @property
    def window_side(self) -> int:
        """Of the windows that the test wants; 0: none."""
        return int(getattr(self.test, "window_side", 0))


def verdict_of(value: NDArray[np.float64], limit: NDArray[np.float64] | float) -> Verdict:
    """Verdict of a test that accepts a measure of inconsistency (n_voxels,), 0 or more, at or below its limit.

    The degree is limit / (limit + value), and 1 where the value is 0: it falls from 1 at perfect agreement through 1/2
    at the limit towards 0, without a bound on the value, and means the same whatever the limit of a voxel is.
    """
    limit = np.broadcast_to(np.asarray(limit, np.float64), value.shape)
    total = limit + value
    # An infinite value over any limit is 0; no value at all agrees, even with no limit.
    degree = np.divide(limit, total, out=np.ones_like(value), where=value > 0)
    half = np.full(value.shape, 0.5)
    return Verdict(degree, half, half)


def require_test(test: object) -> None:
    """Refuse what cannot be called with patches.

    Raises
    ------
    ArgumentError : says what was got.
    """
    if not callable(test) or isinstance(test, type):
        raise ArgumentError(f"expected a photo-consistency test, which is called with patches, got {test!r}")
