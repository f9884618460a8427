"""From the views' planes to one oriented, coloured point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.fusion import Agreement, Means, PlaneMap, PlaneView, add_agreeing, finish_means, start_means
from recon3d.kernels.types import Cameras
from recon3d.scene.neighbours import overlapping_neighbours
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.scratch import Scratch, Stored, load
from recon3d.stereo.patch_match import DepthMap, Matching, plane_normals

_TOLERANCE = 3.0  # pixel footprints between a point and a plane that agree
_MAX_ANGLE = 45.0  # degrees between their normals
_CONTRADICTION = 0.5  # views that see through a point, as a share of those that agree on it


@dataclass(frozen=True)
class ConfirmedDepths:
    """What of a view's depths other views confirm and do not contradict."""

    depths: NDArray[np.float32]
    """(rows, columns) along the optical axis, world units; 0 for all others."""
    weights: NDArray[np.float32]
    """(rows, columns) NCC^2; 0 for all others."""


@dataclass(frozen=True)
class Fusion:
    """Every view's planes, judged by the other views."""

    points: NDArray[np.float64]
    """(n, 3) world positions, means over the views that agree."""
    normals: NDArray[np.float64]
    """(n, 3) unit, outwards."""
    colors: NDArray[np.float64]
    """(n, 3) in [0, 1]."""
    support: NDArray[np.float64]
    """(n,) sum of the agreeing views' weights, NCC^2 each."""
    n_views: NDArray[np.int64]
    """(n,) views that agree, two or more."""
    shifts: NDArray[np.float64]
    """(n,) how far along the normal the mean lies from the plane of the view that a point comes from, world units."""
    depths: tuple[Stored[ConfirmedDepths], ...]
    """Of each view, the depths that the points come from."""

    def cloud(self) -> o3d.t.geometry.PointCloud:
        """Point cloud with ``positions``, ``normals``, ``colors``, and ``confidence`` s / (1 + s) of a support s.

        Besides with ``correlation``, the agreeing views' mean NCC^2, and ``shift``, the ``shifts``.
        """
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(self.points))
        cloud.point.normals = o3d.core.Tensor.from_numpy(self.normals)
        cloud.point.colors = o3d.core.Tensor.from_numpy(self.colors)
        cloud.point.confidence = o3d.core.Tensor.from_numpy((self.support / (1 + self.support))[:, None])
        cloud.point.correlation = o3d.core.Tensor.from_numpy((self.support / self.n_views)[:, None])
        cloud.point.shift = o3d.core.Tensor.from_numpy(self.shifts[:, None])
        return cloud


def fuse(scene: Scene, depth_maps: Sequence[DepthMap | Stored[DepthMap]], matching: Matching) -> Fusion:
    """Keep what several views agree on and hardly any view sees through, in the mean of those that agree.

    Each view's points are compared with the views that may see the same surface, see ``overlapping_neighbours``.

    Matches that no other view confirms are dropped first, so that a stray one cannot speak against the others.

    Raises
    ------
    EmptyReconstructionError : no two views agree on any point.
    """
    if len(depth_maps) != len(scene.views):
        raise ArgumentError(f"expected a depth map of each of {len(scene.views)} views, got {len(depth_maps)}")
    scratch = Scratch()
    pairs = zip(scene.views, depth_maps, strict=True)
    maps = [scratch.keep(_weighed(view, load(each), matching)) for view, each in pairs]
    n_matched = sum(int(np.count_nonzero(each.read().weights)) for each in maps)
    agreement = Agreement(_TOLERANCE * scene.pixel_footprint, float(np.cos(np.radians(_MAX_ANGLE))))
    asked = overlapping_neighbours(scene)
    means = partial(_means, scene.cameras, stride=matching.stride, asked=asked, agreement=agreement)
    confirmed = [np.where(means(maps, n).agreeing > 0, maps[n].read().weights, np.float32(0)) for n in range(len(maps))]
    maps = [each.with_changed(weights=weights) for each, weights in zip(maps, confirmed, strict=True)]
    parts, depths = [], []
    for n, each in enumerate(maps):
        own, found = each.read(), means(maps, n)
        believed = (found.agreeing > 0) & (found.contradicting <= _CONTRADICTION * found.agreeing)
        weights = np.where(believed, own.weights, np.float32(0))
        kept = weights > 0
        colors = np.clip(found.colors[kept] / 255, 0, 1)
        support = found.support[kept]
        shifts = found.offsets[kept] / support
        n_views = found.agreeing[kept].astype(np.int64) + 1
        parts.append((found.points[kept], found.normals[kept], colors, support, n_views, shifts))
        depth = np.divide(1, own.planes[..., 0], out=np.zeros_like(weights), where=kept)
        depths.append(scratch.keep(ConfirmedDepths(depth, weights)))
    points, normals, colors, support, n_views, shifts = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not len(points):
        raise EmptyReconstructionError(
            f"scene {scene.name}: no two views agree on any point; {n_matched:,} pixels found a match"
        )
    return Fusion(points, normals, colors, support, n_views, shifts, tuple(depths))


@dataclass(frozen=True)
class _Weighed:
    """A view's planes as kernels read them."""

    image: NDArray[np.uint8]
    planes: NDArray[np.float32]
    normals: NDArray[np.float32]
    weights: NDArray[np.float32]


def _weighed(view: View, depth_map: DepthMap, matching: Matching) -> _Weighed:
    """A view's planes, whose matches weigh NCC^2."""
    weights = np.where(depth_map.costs <= matching.max_cost, np.square(1 - depth_map.costs), 0).astype(np.float32)
    return _Weighed(view.image, depth_map.planes, plane_normals(view, depth_map.planes, matching.stride), weights)


def _means(
    cameras: Cameras,
    maps: Sequence[Stored[_Weighed]],
    n: int,
    *,
    stride: int,
    asked: NDArray[np.int64],
    agreement: Agreement,
) -> Means:
    """Means of a view's planes with those of the views that it asks, one after the other."""

    def view(number: int) -> PlaneView:
        read = maps[number].read()
        return PlaneView(cameras.at(number), read.image, PlaneMap(read.planes, read.normals, read.weights, stride))

    own = view(n)
    means = Means.none(*own.map.weights.shape)
    start_means(own, means)
    for other in asked[n][asked[n] >= 0]:
        add_agreeing(own, view(int(other)), agreement, means)
    finish_means(own, means)
    return means
