"""Checks of a calibrated camera's matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROTATION_TOLERANCE = 1e-3  # published matrices are rounded


def check_intrinsics(K: NDArray[np.float64]) -> str | None:
    """What is wrong with a 3x3 intrinsic matrix, or None."""
    if not np.isfinite(K).all():
        return "K holds a number that is not finite"
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        return f"expected positive focal lengths, got fx={K[0, 0]:g}, fy={K[1, 1]:g}"
    if np.abs([K[1, 0], K[2, 0], K[2, 1], K[2, 2] - 1.0]).max() > 1e-9:
        return "expected K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"
    return None


def check_extrinsics(cam_from_world: NDArray[np.float64]) -> str | None:
    """What is wrong with a 4x4 rigid transform, or None."""
    if not np.isfinite(cam_from_world).all():
        return "R or t holds a number that is not finite"
    R = cam_from_world[:3, :3]
    error = np.abs(R @ R.T - np.eye(3)).max()
    if error > ROTATION_TOLERANCE:
        return f"R is not a rotation: R R^T differs from the identity by {error:.3g}"
    if np.linalg.det(R) < 0:
        return "R is not a rotation: its determinant is -1 (a reflection)"
    if np.abs(cam_from_world[3] - [0, 0, 0, 1]).max() > 1e-9:
        return "expected the last row 0 0 0 1"
    return None
