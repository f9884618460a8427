"""From the views' planes to one oriented, coloured point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.fusion import Agreement, Means, PlaneMaps, average_planes
from recon3d.scene.neighbours import overlapping_neighbours
from recon3d.scene.scene import Scene
from recon3d.stereo.patch_match import DepthMap, Matching, plane_normals

_TOLERANCE = 3.0  # pixel footprints between a point and a plane that agree
_MAX_ANGLE = 45.0  # degrees between their normals
_CONTRADICTION = 0.5  # views that see through a point, as a share of those that agree on it


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
    weights: NDArray[np.float32]
    """(n_views, rows, columns) weight of the pixels that the points come from; 0 for all others."""

    def cloud(self) -> o3d.t.geometry.PointCloud:
        """Point cloud with ``positions``, ``normals``, ``colors``, and ``confidence`` s / (1 + s) of a support s."""
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(self.points))
        cloud.point.normals = o3d.core.Tensor.from_numpy(self.normals)
        cloud.point.colors = o3d.core.Tensor.from_numpy(self.colors)
        cloud.point.confidence = o3d.core.Tensor.from_numpy((self.support / (1 + self.support))[:, None])
        return cloud


def fuse(scene: Scene, depth_maps: Sequence[DepthMap], matching: Matching) -> Fusion:
    """Keep what several views agree on and hardly any view sees through, in the mean of those that agree.

    Each view's points are compared with the views that may see the same surface, see ``overlapping_neighbours``.

    Matches that no other view confirms are dropped first, so that a stray one cannot speak against the others.

    Raises
    ------
    EmptyReconstructionError : no two views agree on any point.
    """
    if len(depth_maps) != len(scene.views):
        raise ArgumentError(f"expected a depth map of each of {len(scene.views)} views, got {len(depth_maps)}")
    views = scene.packed
    planes = np.stack([depth_map.planes for depth_map in depth_maps])
    costs = np.stack([depth_map.costs for depth_map in depth_maps])
    normals = plane_normals(scene, planes, matching.stride)
    matched = weights = np.where(costs <= matching.max_cost, np.square(1 - costs), 0).astype(np.float32)
    least = float(np.cos(np.radians(_MAX_ANGLE)))
    agreement = Agreement(overlapping_neighbours(scene), _TOLERANCE * scene.pixel_footprint, least)
    for _ in range(2):
        points, mean_normals, colors = np.zeros((3, *planes.shape))
        agreeing, contradicting = np.zeros((2, *costs.shape), np.int64)
        means = Means(points, mean_normals, colors, np.zeros(costs.shape), agreeing, contradicting)
        maps = PlaneMaps(planes, normals, weights, matching.stride)
        average_planes(views.cameras, views.images, maps, agreement, means)
        weights = np.where(means.agreeing > 0, weights, np.float32(0))
    weights = np.where(means.contradicting <= _CONTRADICTION * means.agreeing, weights, np.float32(0))
    kept = weights > 0
    if not kept.any():
        raise EmptyReconstructionError(
            f"scene {scene.name}: no two views agree on any point; {np.count_nonzero(matched):,} pixels found a match"
        )
    colors = np.clip(means.colors[kept] / 255, 0, 1)
    return Fusion(means.points[kept], means.normals[kept], colors, means.support[kept], weights)
