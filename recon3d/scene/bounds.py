"""The box around the object."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import ArgumentError


@dataclass(frozen=True, init=False)
class Bounds:
    """Axis-aligned box, from two opposite corners (3,) in world units; any two, they are sorted.

    Raises
    ------
    ArgumentError : a corner is not three finite numbers.
    """

    low: tuple[float, float, float]
    """Corner of the smallest coordinates, world units."""
    high: tuple[float, float, float]
    """Corner of the largest coordinates, world units."""

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        corners = np.asarray(low, np.float64), np.asarray(high, np.float64)
        if any(corner.shape != (3,) or not np.isfinite(corner).all() for corner in corners):
            raise ArgumentError(f"expected two corners of three finite numbers, got {low!r} and {high!r}")
        object.__setattr__(self, "low", tuple(np.minimum(*corners).tolist()))
        object.__setattr__(self, "high", tuple(np.maximum(*corners).tolist()))

    @classmethod
    def of(cls, box: Bounds | o3d.geometry.AxisAlignedBoundingBox | tuple[ArrayLike, ArrayLike]) -> Bounds:
        """The box of bounds, of Open3D's ``AxisAlignedBoundingBox`` or of two opposite corners (3,)."""
        if isinstance(box, Bounds):
            return box
        if isinstance(box, o3d.geometry.AxisAlignedBoundingBox):
            return cls(box.min_bound, box.max_bound)
        try:
            low, high = box
        except (TypeError, ValueError):
            raise ArgumentError(f"expected Bounds, an AxisAlignedBoundingBox or two corners, got {box!r}") from None
        return cls(low, high)

    @property
    def extent(self) -> NDArray[np.float64]:
        """(3,) lengths of the sides, world units."""
        return np.subtract(self.high, self.low)

    @property
    def longest(self) -> float:
        """Length of the longest side, world units."""
        return float(self.extent.max())

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) the middle, world."""
        return np.add(self.low, self.high) / 2

    @property
    def corners(self) -> NDArray[np.float64]:
        """(8, 3) corners, world."""
        return np.array(list(product(*zip(self.low, self.high, strict=True))))

    def grid(self, nx: int, ny: int, nz: int) -> NDArray[np.float64]:
        """(nx * ny * nz, 3) middles of so many cells along the sides, world."""
        steps = ((np.arange(n) + 0.5) / n for n in (nx, ny, nz))
        cells = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        return np.asarray(self.low + cells * self.extent)

    def places(self, n: int) -> NDArray[np.float64]:
        """(m, 3) places all over the box, about n of them, equally far apart along its sides, world."""
        spacing = (self.extent.prod() / n) ** (1 / 3)
        nx, ny, nz = (max(round(side / spacing), 1) for side in self.extent)
        return self.grid(nx, ny, nz)

    def padded(self, margin: float) -> Bounds:
        """The box with a margin in world units on every side; a negative one shrinks it."""
        return Bounds(np.subtract(self.low, margin), np.add(self.high, margin))

    @property
    def text(self) -> str:
        """The corners as the command line takes them: x0,y0,z0,x1,y1,z1."""
        return place_text((*self.low, *self.high), self.longest)

    def to_open3d(self) -> o3d.geometry.AxisAlignedBoundingBox:
        """The same box as Open3D's ``AxisAlignedBoundingBox``."""
        return o3d.geometry.AxisAlignedBoundingBox(np.array(self.low), np.array(self.high))


def place_text(coordinates: Iterable[float], length: float) -> str:
    """World coordinates as the command line takes them, to a ten-thousandth of a length, however far from the origin.

    Six significant digits at least; all seventeen at most.
    """
    values = tuple(coordinates)
    beyond = (max(abs(x) / length, 1.0) if length > 0 else 1.0 for x in values)
    digits = (min(max(6, 5 + int(np.ceil(np.log10(times)))), 17) for times in beyond)
    return ",".join(f"{x:.{n}g}" for x, n in zip(values, digits, strict=True))
