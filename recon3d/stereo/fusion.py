"""From the views' planes to one oriented, coloured point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.kernels.planes import average_planes
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
    views, asked = scene.packed, overlapping_neighbours(scene)
    cameras = scene.packed.cameras
    planes = np.stack([depth_map.planes for depth_map in depth_maps])
    costs = np.stack([depth_map.costs for depth_map in depth_maps])
    normals = plane_normals(scene, planes, matching.stride)
    matched = weights = np.where(costs <= matching.max_cost, np.square(1 - costs), 0).astype(np.float32)
    for _ in range(2):
        points, means, colors = np.zeros((3, *planes.shape))
        support = np.zeros(costs.shape)
        agreeing, contradicting = np.zeros((2, *costs.shape), np.int64)
        average_planes(
            cameras.projections, cameras.centers, cameras.world_from_pixel, views.images, cameras.sizes, planes,
            normals, weights, asked, matching.stride, _TOLERANCE * scene.pixel_footprint,
            float(np.cos(np.radians(_MAX_ANGLE))), points, means, colors, support, agreeing, contradicting,
        )  # fmt: skip
        weights = np.where(agreeing > 0, weights, np.float32(0))
    weights = np.where(contradicting <= _CONTRADICTION * agreeing, weights, np.float32(0))
    kept = weights > 0
    if not kept.any():
        raise EmptyReconstructionError(
            f"scene {scene.name}: no two views agree on any point; {np.count_nonzero(matched):,} pixels found a match"
        )
    return Fusion(points[kept], means[kept], np.clip(colors[kept] / 255, 0, 1), support[kept], weights)
