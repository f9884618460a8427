"""A reconstruction brought into the frame of a ground truth before it is measured.

References
----------
P. Besl, N. McKay, "A method for registration of 3-D shapes", PAMI 14(2), 1992.
D. Chetverikov, D. Stepanov, P. Krsek, "Robust Euclidean alignment of 3D point sets: the trimmed iterative closest point
algorithm", Image and Vision Computing 23(3), 2005.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recon3d.evaluation.distances import Shape, sample_surface
from recon3d.scene.similarity import Similarity

_SAMPLES = 15000  # of each surface
_COARSE_SAMPLES, _COARSE_STEPS = 1500, 30
_STEPS = 200
_KEPT = 0.8  # of the nearest pairs: the rest has no counterpart
_SETTLED = 1e-6  # of the ground truth's size


def align(
    reconstruction: Shape,
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud,
    *,
    scaling: bool,
    start: Similarity | None = None,
    seed: int = 0,
) -> Similarity:
    """Take a reconstruction to a ground truth, by iterated closest points of both surfaces, the farthest left out.

    Parameters
    ----------
    scaling : whether the reconstruction's unit is unknown.
    start : near the truth, such as that between the centres of cameras. When None, both shapes' middles and principal
        axes are tried, and the frames as they are.
    seed : of the surface samples.
    """
    rng = np.random.default_rng(seed)
    source, target = (_samples(shape, rng) for shape in (reconstruction, ground_truth))
    if start is None:
        few, aim = (points[:: max(1, len(points) // _COARSE_SAMPLES)] for points in (source, target))
        tried = (
            _closest_points(few, aim, guess, scaling=scaling, steps=_COARSE_STEPS)
            for guess in _guesses(source, target, scaling=scaling)
        )
        start = min(tried, key=lambda each: each[1])[0]
    return _closest_points(source, target, start, scaling=scaling, steps=_STEPS)[0]


def _samples(shape: Shape, rng: np.random.Generator) -> NDArray[np.float64]:
    """(n, 3) about so many points of a surface, in random order."""
    spacing = 1.0
    if isinstance(shape, o3d.geometry.TriangleMesh):
        spacing = float(np.sqrt(max(shape.get_surface_area(), 1e-300) / _SAMPLES))
    points = sample_surface(shape, spacing, rng)[0]
    return points[rng.permutation(len(points))[:_SAMPLES]]


def _guesses(source: NDArray[np.float64], target: NDArray[np.float64], *, scaling: bool) -> list[Similarity]:
    """The frames as they are, and the four ways in which the principal axes of both go together."""
    middles, axes, sizes = [], [], []
    for points in (source, target):
        middles.append(points.mean(axis=0))
        _, singular, Vt = np.linalg.svd(points - middles[-1], full_matrices=False)
        axes.append(Vt * np.array([1, 1, np.linalg.det(Vt)])[:, None])
        sizes.append(float(np.linalg.norm(singular)) / np.sqrt(len(points)))
    scale = sizes[1] / sizes[0] if scaling else 1.0
    found = [Similarity.identity()]
    for a, b in product((1, -1), (1, -1)):
        R = axes[1].T @ np.diag([a, b, a * b]) @ axes[0]
        found.append(Similarity(scale, R, middles[1] - scale * R @ middles[0]))
    return found


def _closest_points(
    source: NDArray[np.float64], target: NDArray[np.float64], start: Similarity, *, scaling: bool, steps: int
) -> tuple[Similarity, float]:
    """Trimmed iterated closest points, both ways, and the root mean squared distance of what was kept."""
    trees = cKDTree(source), cKDTree(target)
    size = float(np.linalg.norm(np.ptp(target, axis=0)))
    found, residual = start, np.inf
    for _ in range(steps):
        forth, nearest = trees[1].query(found(source))
        back, nearest_back = trees[0].query(found.inverse()(target))
        kept, kept_back = forth <= np.quantile(forth, _KEPT), back <= np.quantile(back, _KEPT)
        before = residual
        residual = float(np.sqrt(np.mean(np.concatenate([forth[kept], found.scale * back[kept_back]]) ** 2)))
        found = Similarity.between(
            np.vstack([source[kept], source[nearest_back[kept_back]]]),
            np.vstack([target[nearest[kept]], target[kept_back]]),
            scaling=scaling,
        )
        if abs(before - residual) < _SETTLED * size:
            break
    return found, residual
