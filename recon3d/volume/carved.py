"""What carving returns: the verdict on every voxel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.summary import Summarised
from recon3d.values import ByContent
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice


class Label(IntEnum):
    """Why a voxel is in or out."""

    UNSEEN = 0
    """Outside every image, or never visited."""
    BACKGROUND = 1
    """Carved: some silhouette excludes it."""
    INCONSISTENT = 2
    """Carved: the photo-consistency test failed."""
    HIDDEN = 3
    """Behind accepted voxels in every view: inside the object, or in its shadow."""
    CONSISTENT = 4
    """Accepted and coloured."""


class Carved(Protocol):
    """What carving leaves, whether all voxels are stored or only those near the surface."""

    @property
    def lattice(self) -> Lattice:
        """Where the voxels lie."""

    @property
    def n_accepted(self) -> int:
        """Number of accepted voxels: those that some pixel sees, with their colours."""

    def counts(self) -> dict[str, int]:
        """Number of voxels with each label, by its name."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that is known beside the lattice, for a file."""

    def to_voxel_grid(self) -> o3d.geometry.VoxelGrid:
        """Open3D voxel grid of the coloured voxels, with the same origin, indices and colours."""

    def dense(self) -> CarvedVolume:
        """The same voxels, all stored.

        Raises
        ------
        VolumeTooLargeError : they would not fit into the memory that is free now.
        """

    def summary(self) -> Mapping[str, object]:
        """Table of what is left."""

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of what is left, seen along the three axes."""


@dataclass(frozen=True, repr=False, eq=False)
class CarvedVolume(ByContent, Summarised):
    """The accepted voxels, and what was found out about the others."""

    volume: CarvingVolume
    """Occupied: the accepted voxels, with their colours."""
    labels: NDArray[np.uint8]
    """(nx, ny, nz) ``Label`` of every voxel."""
    degree: NDArray[np.float32]
    """(nx, ny, nz) degree of photo-consistency in [0, 1]; NaN where the test was not asked."""
    n_views: NDArray[np.uint16]
    """(nx, ny, nz) N(v), views that saw the voxel when it was judged."""
    distance: NDArray[np.float32] | None = None
    """(nx, ny, nz) signed distance of voxel centres to a surface that holds the solid: the visual hull, or what votes
    left of it; world units, positive inside; None where the method knows none."""

    @classmethod
    def untouched(cls, volume: CarvingVolume | Lattice, distance: NDArray[np.float32] | None = None) -> CarvedVolume:
        """Nothing judged or accepted yet, on a lattice or that of a volume, with the distance (nx, ny, nz) if known."""
        shape = volume.shape
        return cls(
            volume=CarvingVolume(
                volume.origin, volume.voxel_size, np.zeros(shape, np.bool_), np.zeros((*shape, 3), np.uint8)
            ),
            labels=np.full(shape, Label.UNSEEN, np.uint8),
            degree=np.full(shape, np.nan, np.float32),
            n_views=np.zeros(shape, np.uint16),
            distance=distance,
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All that is known beside the lattice, for a file."""
        known = {name: getattr(self, name) for name in ("labels", "degree", "n_views", "distance")}
        known |= {"occupied": self.volume.occupied, "colors": self.volume.colors}
        return {name: array for name, array in known.items() if array is not None}

    @classmethod
    def from_arrays(cls, lattice: Lattice, arrays: Mapping[str, NDArray[Any]]) -> CarvedVolume:
        """The carved volume that ``arrays`` were of, on the same lattice."""
        found = dict(arrays)
        volume = CarvingVolume(lattice.origin, lattice.voxel_size, found.pop("occupied"), found.pop("colors"))
        return cls(volume, **found)

    @property
    def lattice(self) -> Lattice:
        """Where the voxels lie."""
        return self.volume.lattice

    @property
    def n_accepted(self) -> int:
        """Number of accepted voxels."""
        return self.volume.n_occupied

    def to_voxel_grid(self) -> o3d.geometry.VoxelGrid:
        """Open3D voxel grid of the accepted voxels, with the same origin, indices and colours."""
        return self.volume.to_voxel_grid()

    def dense(self) -> CarvedVolume:
        """Itself: all voxels are stored."""
        return self

    @property
    def with_interior(self) -> CarvingVolume:
        """The accepted voxels and those hidden behind them in every view: a shape with an inside, for a mesh."""
        return self.volume.with_occupancy((self.labels == Label.HIDDEN) | (self.labels == Label.CONSISTENT))

    def set_labels(self, voxels: NDArray[np.int64], label: int) -> None:
        """Label voxels (n, 3)."""
        self.labels[tuple(voxels.T)] = label

    def record(self, voxels: NDArray[np.int64], degree: NDArray[np.float64], n_views: NDArray[np.int64]) -> None:
        """Keep what the test said of voxels (n, 3)."""
        self.degree[tuple(voxels.T)] = degree
        self.n_views[tuple(voxels.T)] = n_views

    def accept(self, voxels: NDArray[np.int64], colors: NDArray[np.uint8]) -> None:
        """Occupy voxels (n, 3) with colours (n, 3)."""
        self.volume.occupied[tuple(voxels.T)] = True
        self.volume.colors[tuple(voxels.T)] = colors

    def counts(self) -> dict[str, int]:
        """Number of voxels with each label."""
        numbers = np.bincount(self.labels.ravel(), minlength=len(Label))
        return {label.name.lower(): int(numbers[label]) for label in Label}

    def count_text(self) -> str:
        """The counts in one line."""
        return ", ".join(f"{number:,} {name}" for name, number in self.counts().items())

    def summary(self) -> dict[str, object]:
        """Table of the verdicts."""
        return {**self.volume.summary(), **{name: f"{number:,}" for name, number in self.counts().items()}}

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB picture of the accepted voxels seen along the three axes."""
        return self.volume.picture()
