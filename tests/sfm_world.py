"""A textured box on a plate, and cameras that structure from motion finds."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scenes import box_mesh

from recon3d.datasets.synthetic import Camera, ring

WIDTH, HEIGHT, FOCAL = 240, 180, 315.0


def blocks(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of every size: cells of several lattices, each of a grey drawn at random."""
    grey = np.full(len(points), 0.5)
    greys = np.random.default_rng(11).uniform(-1, 1, (3, 64, 64, 64))
    for table, cell, weight in zip(greys, (0.41, 0.17, 0.07), (0.2, 0.2, 0.15), strict=True):
        i, j, k = np.floor(points / cell + 0.5).astype(np.int64).T % 64
        grey += weight * table[i, j, k]
    return np.clip(grey[:, None] * [1.0, 0.95, 0.9], 0.03, 1)


def world() -> o3d.geometry.TriangleMesh:
    """A box on a plate."""
    return box_mesh(1.6, 1.2, 1.2).translate((0, 0, 0.6)) + box_mesh(5.0, 5.0, 0.1).translate((0, 0, -0.05))


def taken(n_views: int = 12) -> list[Camera]:
    """Square pixels, principal point in the middle, 12 degrees from view to view."""
    K = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
    arc = 12.0 * (n_views - 1)
    around = ring(
        np.zeros(3), n_views=n_views, distance=5.0, width=WIDTH, height=HEIGHT, focal=FOCAL, elevation=35, arc=arc
    )
    return [Camera(K, camera.cam_from_world, WIDTH, HEIGHT) for camera in around]
