"""Why cameras do not see the box that they should: by the mistakes that put it into their images when undone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.view import View

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Between OpenGL's camera axes (y up, z backward) and OpenCV's (y down, z forward)."""

_UNITS = (0.001, 1000.0, 0.01, 100.0, 0.1, 10.0, 0.0254, 1 / 0.0254)
_PROBES = 6  # along each side
_HELD = 0.8  # of the box, in the median image, where a mistake is undone
_MIDDLE = 0.5  # of the way from the image's middle to its border, for the box's middle
_LARGE = 0.1  # of the image's longer side, that the box must cover
_POSES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "the matrices look like camera-to-world: give their inverses": lambda pose: np.asarray(np.linalg.inv(pose)),
    "the cameras' axes look like OpenGL's (y up, z backward): give numpy.diag([1, -1, -1, 1]) @ cam_from_world": (
        lambda pose: FLIP @ pose
    ),
    "the matrices look like camera-to-world with OpenGL's axes (y up, z backward): give "
    "numpy.diag([1, -1, -1, 1]) @ inv(matrix)": lambda pose: FLIP @ np.linalg.inv(pose),
    "the column t looks like the camera's centre: give t = -R @ centre": (
        lambda pose: _pose(pose[:3, :3], -pose[:3, :3] @ pose[:3, 3])
    ),
    "R looks transposed: give R.T, and t as it is": lambda pose: _pose(pose[:3, :3].T, pose[:3, 3]),
}


def why_not_seen(views: Sequence[View], bounds: Bounds) -> str | None:
    """A sentence on the one mistake that would explain it; None: none does, or several do.

    Parameters
    ----------
    views : n, most of which do not see the bounds.
    """
    probes = np.vstack([bounds.center, bounds.grid(_PROBES, _PROBES, _PROBES)])
    poses = np.array([view.cam_from_world for view in views])
    held = [text for text, undone in _POSES.items() if _fits(views, np.array([undone(pose) for pose in poses]), probes)]
    held += [
        f"Multiplied by {factor:g} they are seen: the bounds, or the cameras, are in another unit"
        for factor in _UNITS
        if _fits(views, poses, factor * probes)
    ]
    return f"{held[0][0].upper()}{held[0][1:]}." if len(held) == 1 else None


def _pose(R: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.vstack([np.column_stack([R, t]), [0.0, 0.0, 0.0, 1.0]])


def _fits(views: Sequence[View], poses: NDArray[np.float64], probes: NDArray[np.float64]) -> bool:
    """Whether points (n, 3), the first of which is the middle, fill a part in the middle of most images."""
    held, off, sides = [], [], []
    for view, pose in zip(views, poses, strict=True):
        seen = probes @ pose[:3, :3].T + pose[:3, 3]
        before = seen[:, 2] > 0
        pixels = (seen @ view.K.T)[:, :2] / np.where(before, seen[:, 2], 1)[:, None]
        size = np.array([view.width, view.height])
        within = before & (pixels > -0.5).all(axis=1) & (pixels < size - 0.5).all(axis=1)
        held.append(within.mean())
        off.append(np.abs((pixels[0] + 0.5) / (size / 2) - 1).max() if before[0] else np.inf)
        sides.append(np.ptp(pixels[within], axis=0).max() / size.max() if within.any() else 0.0)
    return bool(np.median(held) >= _HELD and np.median(off) <= _MIDDLE and np.median(sides) >= _LARGE)
