"""What travels together through kernels.

Kernels are compiled for each combination of their arguments' types, to which an array's layout, and whether it can be
written to, belong. Names of arrays' extents: n_views, height and width of the packed images.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray


class Lattice(NamedTuple):
    """Where voxels lie: (i, j, k) spans ``origin + voxel_size * (i, j, k)`` to the same of (i + 1, j + 1, k + 1)."""

    origin: tuple[float, float, float]
    """Lowest corner of voxel (0, 0, 0), world units."""
    voxel_size: float
    """Edge length, world units."""
    shape: tuple[int, int, int]
    """(nx, ny, nz)."""


class Camera(NamedTuple):
    """One view's camera; pixels have integer centres."""

    projection: NDArray[np.float64]
    """(3, 4) P = K [R | t]."""
    world_from_pixel: NDArray[np.float64]
    """(3, 3) R^T K^-1: from homogeneous pixels to ray directions of depth one, world."""
    center: NDArray[np.float64]
    """(3,) world."""
    focal: float
    """Focal length, pixels."""
    size: NDArray[np.int64]
    """(2,) width and height, pixels."""


class Cameras(NamedTuple):
    """All views' cameras, each field a ``Camera``'s."""

    projections: NDArray[np.float64]
    """(n_views, 3, 4)."""
    world_from_pixel: NDArray[np.float64]
    """(n_views, 3, 3)."""
    centers: NDArray[np.float64]
    """(n_views, 3) world."""
    focals: NDArray[np.float64]
    """(n_views,) pixels."""
    sizes: NDArray[np.int64]
    """(n_views, 2) width and height, pixels."""

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Self:
        """Those of several views."""
        return cls(*map(np.stack, zip(*cameras, strict=True)))

    def at(self, view: int) -> Camera:
        """That of one view."""
        return Camera(*(field[view] for field in self))

    def part(self, views: Sequence[int]) -> Self:
        """Those of some views."""
        fields: list[Any] = [field[views] for field in self]
        return type(self)(*fields)


class Compared(NamedTuple):
    """A view and others that it is compared with.

    A pixel p of the view at depth z lies at ``z * homographies[j] p + epipoles[j]`` in view j.
    """

    image: NDArray[np.float32]
    """(height, width) luminance of the view, grey levels."""
    size: NDArray[np.int64]
    """(2,) its width and height, pixels."""
    others: NDArray[np.float32]
    """(n_others, height, width) luminance of the others, grey levels."""
    other_sizes: NDArray[np.int64]
    """(n_others, 2) their width and height, pixels."""
    homographies: NDArray[np.float64]
    """(n_others, 3, 3) between homogeneous pixels, by the plane at infinity."""
    epipoles: NDArray[np.float64]
    """(n_others, 3) homogeneous pixels where the others show the view's camera, scaled to go with depths."""

    @classmethod
    def between(cls, image: NDArray[np.float32], camera: Camera, others: NDArray[np.float32], cameras: Cameras) -> Self:
        """Of a view's luminance and camera and the others'."""
        P = cameras.projections
        homographies = P[:, :, :3] @ camera.world_from_pixel
        return cls(image, camera.size, others, cameras.sizes, homographies, P[:, :, :3] @ camera.center + P[:, :, 3])


class DepthMaps(NamedTuple):
    """Depths that all views' pixels were found to have."""

    depths: NDArray[np.float32]
    """(n_views, rows, columns) along the optical axis, world units; 0 where there is none."""
    weights: NDArray[np.float32]
    """(n_views, rows, columns); 0: says nothing."""
    stride: int
    """Pixels between those that have a depth; row r and column c belong to pixel (u, v) = (c, r) times that."""


class Votes(NamedTuple):
    """What is known of the surface at voxels, (n,) or (nx, ny, nz)."""

    distance: NDArray[np.floating]
    """Signed distance, positive behind the surface."""
    support: NDArray[np.floating]
    """Sum of the weights that the distance comes from; 0: nothing is known."""


class Footprints(NamedTuple):
    """Where voxels lie in the views, and what of that is of use."""

    boxes: NDArray[np.int32]
    """(n, n_views, 4) first and last column u, first and last row v; a last one before its first: not seen."""
    counts: NDArray[np.int64]
    """(n, n_views) pixels of a box that show the voxel."""
    in_frame: NDArray[np.bool_]
    """(n,) whether foreground of any view lies in the voxel's boxes."""


class Pixels(NamedTuple):
    """A ragged array: view j of voxel n owns the pixels ``view_starts[n, j]`` to ``view_starts[n, j + 1]``."""

    colors: NDArray[np.uint8]
    """(n_pixels, 3) RGB."""
    view_starts: NDArray[np.int64]
    """(n, n_views + 1)."""


class Observed(NamedTuple):
    """Voxels, and the mean colour that each view shows of each."""

    voxels: NDArray[np.int64]
    """(n, 3) indices."""
    colors: NDArray[np.uint8]
    """(n, n_views, 3) RGB."""
    seen: NDArray[np.bool_]
    """(n, n_views) whether the view shows any foreground there."""


class Nearest(NamedTuple):
    """The nearest of some triangles to each of n points."""

    squared: NDArray[np.float64]
    """(n,) squared distance, world units."""
    triangle: NDArray[np.int64]
    """(n,) index."""


class Ray(NamedTuple):
    """A ray on its way through a lattice, in voxels from the lattice's origin."""

    start: NDArray[np.float64]
    """(3,)."""
    step: NDArray[np.float64]
    """(3,) direction, of any length."""
    place: NDArray[np.int64]
    """(3,) voxel that the ray is in."""
