"""Cameras of matrices whose sign, or whose world's handedness, is not recon3d's."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import DataError
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import ROTATION_TOLERANCE

MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
"""Takes a left-handed world to a right-handed one, and back: z is turned over."""

_PARALLEL = 1e-3  # squared sine of the angle between axes below which they meet nowhere


def mirrored(bounds: Bounds) -> Bounds:
    """The box in the mirrored world."""
    signs = np.diag(MIRROR)[:3]
    return Bounds(bounds.low * signs, bounds.high * signs)


def right_handed(poses: Mapping[str, ArrayLike]) -> tuple[dict[str, NDArray[np.float64]], bool]:
    """World to camera transforms (3, 4) by what an error calls them, mirrored where all are reflections, and whether.

    Raises
    ------
    DataError : some are reflections and some are not.
    """
    found = {where: np.asarray(pose, np.float64) for where, pose in poses.items()}
    left = [where for where, pose in found.items() if _is_reflection(pose[:3, :3])]
    if not left:
        return found, False
    if len(left) < len(found):
        raise DataError(
            f"{left[0]}: R is not a rotation: its determinant is -1 (a reflection), as of {len(left)} of {len(found)} "
            "cameras; expected none, or all, of a left-handed world"
        )
    return {where: pose @ MIRROR for where, pose in found.items()}, True


def signed(matrices: Mapping[str, NDArray[np.float64]]) -> tuple[dict[str, NDArray[np.float64]], bool]:
    """Projection matrices (3, 4) of a right-handed world in front of the cameras, and whether they were of its mirror.

    A projection matrix is given up to a factor. What all cameras look at, the point nearest to their optical axes, lies
    before them and settles its sign. Where the determinant of the left 3x3 part is negative then, the world of the
    matrices is left-handed, and z is turned over. Axes that do not meet leave the sign open; the world is taken to be
    right-handed then.

    Parameters
    ----------
    matrices : by what an error calls them.

    Raises
    ------
    DataError : a matrix is singular, or they are not of one world.

    References
    ----------
    Hartley, Zisserman, "Multiple View Geometry in Computer Vision", 2004, sections 6.2.3 and 6.2.4.
    """
    scaled = {where: _scaled(P, where) for where, P in matrices.items()}
    positive = np.array([np.linalg.det(P[:, :3]) > 0 for P in scaled.values()])
    seen = _looked_at(np.array(list(scaled.values())))
    if seen is None:
        signs = np.where(positive, 1.0, -1.0)
    else:
        signs = np.array([1.0 if P[2] @ np.append(seen, 1.0) > 0 else -1.0 for P in scaled.values()])
    right = positive == (signs > 0)
    if not (right.all() or not right.any()):
        if not (positive.all() or not positive.any()):
            odd = list(scaled)[int(np.argmin(right == (right.mean() > 0.5)))]
            hand = "right" if right.mean() < 0.5 else "left"
            raise DataError(
                f"{odd}: expected matrices of one world: this one's is {hand}-handed, most others' is not, if all "
                "cameras look at one place"
            )
        signs, right = np.ones(len(signs)), positive  # some look away: they are as they were scaled
    mirror = np.eye(4) if right.all() else MIRROR
    return {where: sign * P @ mirror for (where, P), sign in zip(scaled.items(), signs, strict=True)}, not right.all()


def _is_reflection(R: NDArray[np.float64]) -> bool:
    near = bool(np.isfinite(R).all()) and np.abs(R @ R.T - np.eye(3)).max() < ROTATION_TOLERANCE
    return bool(near and np.linalg.det(R) < 0)


def _scaled(P: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """A matrix whose third row takes points to their depths."""
    length = float(np.linalg.norm(P[2, :3]))
    if not length > 0 or not abs(np.linalg.det(P[:, :3] / length)) > 1e-9:
        raise DataError(f"{where}: expected a projection matrix of a camera at a finite place, got a singular one")
    return P / length


def _looked_at(matrices: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """(3,) point nearest to the optical axes of matrices (n, 3, 4), by least squares; None where they are parallel."""
    axes = matrices[:, 2, :3]
    centers = -np.linalg.solve(matrices[:, :, :3], matrices[:, :, 3:])[..., 0]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _PARALLEL * len(matrices):
        return None
    return np.asarray(np.linalg.solve(total, np.einsum("nij,nj->i", across, centers)))
