"""Exposure and white balance of views, from the surface that they see together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.kernels.vertex_colors import Samples, Vertices, sample_view
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene
from recon3d.scratch import Stored
from recon3d.surface.trust import TrustedPixels
from recon3d.surface.visibility import VertexVisibility

_SAMPLES = 1 << 21  # of all views together, at most
_POINTS = 20_000
_DARK, _BRIGHT = 8.0, 247.0  # grey levels beyond which a sensor's answer is not proportional
_ROUNDS = 12
_ROUNDING = 0.02  # difference of logarithms below which all count the same
_HELD = 0.01  # share of a view's weight that holds it at a gain of one


def view_gains(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, caster: RayCaster, trusted: Sequence[Stored[TrustedPixels]]
) -> NDArray[np.float64]:
    """(n_views, 3) factors of the views' red, green and blue that even out what they show of the same surface.

    The logarithm of a grey level is the surface's plus the view's. Those of the views that leave the least sum of
    absolute differences are found by reweighted least squares, so highlights and what is mistaken count little. The
    factors' geometric mean is one, and a view that sees nothing with others has one.

    Parameters
    ----------
    mesh : with vertex normals.
    caster : of the mesh.
    trusted : pixels of each view.

    References
    ----------
    Brown, Lowe, "Automatic panoramic image stitching using invariant features", IJCV 2007 (gain compensation).
    """
    chosen = _spread(len(mesh.vertices), min(_POINTS, max(_SAMPLES // len(scene.views), 1)))
    points = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.asarray(mesh.vertices)[chosen]), o3d.utility.Vector3iVector()
    )
    points.vertex_normals = o3d.utility.Vector3dVector(np.asarray(mesh.vertex_normals)[chosen])
    seen = VertexVisibility.of(points, scene, caster).seen
    vertices = Vertices(np.asarray(points.vertices), np.asarray(points.vertex_normals))
    cameras = scene.cameras
    levels, weights = np.ones((*seen.shape, 3)), np.zeros(seen.shape)
    for n, view in enumerate(scene.views):
        own = np.flatnonzero(seen[n])
        samples = Samples(np.empty((len(own), 3)), np.empty(len(own)))
        sample_view(vertices, own, cameras.at(n), view.image, trusted[n].read().trust.copy(), samples)
        proportional = ((samples.colors > _DARK) & (samples.colors < _BRIGHT)).all(axis=1)
        levels[n, own[proportional]], weights[n, own[proportional]] = (each[proportional] for each in samples)
    weights[:, (weights > 0).sum(axis=0) < 2] = 0  # nothing to compare with
    weights /= np.maximum(weights.max(axis=0), 1e-300)
    return np.column_stack([np.exp(-_offsets(np.log(levels[..., channel]), weights)) for channel in range(3)])


def _offsets(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n_views,) of mean zero, such that values (n_views, n) less their view's offset agree best, point by point."""
    offsets = np.zeros(len(values))
    current = weights
    for _ in range(_ROUNDS):
        together = np.maximum(current.sum(axis=0), 1e-300)
        share = current / together
        # The points' own values are eliminated from the normal equations.
        own = current.sum(axis=1)
        normal = np.diag(own * (1 + _HELD) + 1e-9) - current @ share.T
        means = (share * values).sum(axis=0)
        offsets = np.linalg.solve(normal, (current * (values - means)).sum(axis=1))
        means = (share * (values - offsets[:, None])).sum(axis=0)
        left = np.abs(values - offsets[:, None] - means)
        current = weights / np.maximum(left, _ROUNDING)
    seen = weights.any(axis=1)
    return offsets - (offsets[seen].mean() if seen.any() else 0.0) * seen


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """(at most most,) indices, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
