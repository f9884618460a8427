"""How a camera stands before a turntable, by the silhouettes of an object without texture before a plain background."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from recon3d.calibration.photographs import PhotoFile
from recon3d.errors import SceneError
from recon3d.scene.background import BLACK, foreground, frame_color, has_plain_frame
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.enclosing import enclosing_box, silhouettes_explained
from recon3d.scene.image_file import read_image
from recon3d.scene.photograph import Photograph
from recon3d.scene.view import View

_LONG_SIDE = 240  # pixels of the reduced photographs
_VIEWS = 10  # that are compared
_STEP = float(np.radians(2.0))  # of the first simplex
_TRIED = 18  # poses, in each box
_MARGINS = (0.15, 0.02)  # of the longest side, around what lies in all silhouettes of the pose before

Poses = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""(n, 4, 4) cam_from_world of tilt, pan and roll (3,), radians."""


def reduced_views(photographs: Sequence[PhotoFile], K: NDArray[np.float64]) -> dict[int, View] | None:
    """Some of the photographs, small, with their silhouettes, by number; None: their background is not of one color.

    Parameters
    ----------
    K : (3, 3), pixels of the photographs.
    """
    views = {}
    for n in np.unique(np.linspace(0, len(photographs) - 1, min(_VIEWS, len(photographs))).round().astype(int)):
        photograph = photographs[n]
        scale = min(1.0, _LONG_SIDE / max(photograph.width, photograph.height))
        camera = Camera(K, np.eye(4), photograph.width, photograph.height).at(scale)
        image = Photograph(read_image(photograph.path)).read(scale)
        if not has_plain_frame(image):
            return None
        color = frame_color(image)
        color = color if max(color) > 48 else BLACK
        views[int(n)] = View(camera, image, foreground(image, color=color), photograph.name)
    return views


class TiltAndPan(NamedTuple):
    """What silhouettes tell of a camera's pose; a roll of a few degrees they hardly show."""

    tilt: float
    """Radians."""
    pan: float
    """Radians."""
    explained: float
    """Share of the average silhouette that what lies in all of them fills."""


def fitted(views: dict[int, View], poses: Poses, tilt: float, *, adjust: bool) -> TiltAndPan:
    """Tilt and pan with which the silhouettes explain each other best.

    Parameters
    ----------
    views : small ones, by the number of their pose.
    tilt : to start from, radians.
    adjust : change them; else only say how well they explain each other as they are.
    """
    x, step, share = np.array([tilt, 0.0]), _STEP, 0.0
    for margin in _MARGINS if adjust else _MARGINS[:1]:
        try:
            box, _ = enclosing_box(_placed(views, poses, x))
        except SceneError:
            break
        unexplained = partial(_unexplained, views, poses, box.padded(margin * box.longest))
        options = {"maxfev": _TRIED, "initial_simplex": np.vstack([x, x + step * np.eye(2)]), "fatol": 1e-4}
        found = minimize(unexplained, x, method="Nelder-Mead", options=options) if adjust else None
        x, share = (x, 1 - unexplained(x)) if found is None else (np.asarray(found.x), 1 - float(found.fun))
        step /= 4
    return TiltAndPan(float(x[0]), float(x[1]), share)


def _unexplained(views: dict[int, View], poses: Poses, box: Bounds, x: NDArray[np.float64]) -> float:
    """Share of the average silhouette, inside a box, that what lies in all of them does not fill."""
    return 1.0 - float(silhouettes_explained(_placed(views, poses, x), box).mean())


def _placed(views: dict[int, View], poses: Poses, x: NDArray[np.float64]) -> list[View]:
    """The views with poses of tilt and pan (2,), radians."""
    placed = poses(np.array([x[0], x[1], 0.0]))
    return [
        View(Camera(view.K, placed[n], view.width, view.height), view.photograph, view.mask, view.name)
        for n, view in views.items()
    ]
