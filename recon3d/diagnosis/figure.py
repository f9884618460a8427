"""Cameras, bounds and matched points, drawn in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.diagnosing import Diagnosis
from recon3d.io.files import atomic_path
from recon3d.scene.camera import Camera

if TYPE_CHECKING:  # a second to import, and most runs draw nothing
    from matplotlib.figure import Figure

_FRUSTUM = 0.15  # of the distance to the bounds
_POINTS = 3000


def plot_scene(
    diagnosis: Diagnosis, proposed: Sequence[Camera] = (), missing: NDArray[np.float64] | None = None
) -> Figure:
    """Cameras as frusta, those that a finding names in red, the bounds, and matched points.

    Parameters
    ----------
    proposed : cameras of further photographs; in green, with their numbers.
    missing : (n, 3) places on the surface that was not measured, world, instead of the matched points; in red.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 7), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    blamed = {name for finding in diagnosis.findings for name in finding.views}
    middle = diagnosis.middle
    middle = middle if np.isfinite(middle).all() else diagnosis.centers.mean(axis=0)
    distances = np.linalg.norm(diagnosis.centers - middle, axis=1)
    depth = _FRUSTUM * max(float(np.median(distances)), 1e-12)
    for view in diagnosis.views:
        color = "tab:red" if view.name in blamed else "tab:blue"
        _draw_frustum(axes, view.calibration, depth, color)
        axes.text(*view.center, Path(view.name).stem, fontsize=6, color=color)
    for a, b in combinations([] if diagnosis.bounds is None else diagnosis.bounds.corners, 2):
        if np.count_nonzero(a != b) == 1:
            axes.plot(*np.stack([a, b]).T, color="tab:orange", linewidth=1)
    for n, camera in enumerate(proposed):
        _draw_frustum(axes, camera, depth, "tab:green")
        axes.text(*_center(camera), f"next {n + 1}", fontsize=8, color="tab:green")
    points = diagnosis.points if missing is None else missing
    if len(points):
        middle, reach = np.median(points, axis=0), float(distances.max())
        near = points[np.linalg.norm(points - middle, axis=1) < reach]
        axes.scatter(*near[:: 1 + len(near) // _POINTS].T, s=1, color="0.3" if missing is None else "tab:red")
    told = "" if diagnosis.bounds is None else ", bounds in orange"
    told += "" if missing is None else ",\nunmeasured surface in red, proposed views in green"
    axes.set(xlabel="x", ylabel="y", zlabel="z", title=f"{diagnosis.name}: {len(diagnosis.views)} cameras{told}")
    axes.set_aspect("equal")
    return figure


def save_figure(
    diagnosis: Diagnosis,
    path: Path | str,
    *,
    proposed: Sequence[Camera] = (),
    missing: NDArray[np.float64] | None = None,
) -> Path:
    """Draw a scene to a file, whose ending names the format; returns the path.

    Parameters
    ----------
    proposed, missing : further cameras, and places (n, 3) on the unmeasured surface; see ``plot_scene``.

    Raises
    ------
    ValueError : matplotlib writes no such format.
    """
    with atomic_path(path) as temporary:
        plot_scene(diagnosis, proposed, missing).savefig(temporary, dpi=150)
    return Path(path)


def _center(camera: Camera) -> NDArray[np.float64]:
    """(3,) where a camera is, world."""
    return np.asarray(-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3])


def _draw_frustum(axes: Any, camera: Camera, depth: float, color: str) -> None:
    """The pyramid from a camera's centre to its image at a depth, world units."""
    width, height, center = camera.width - 0.5, camera.height - 0.5, _center(camera)
    pixels = np.array([[-0.5, -0.5, 1], [width, -0.5, 1], [width, height, 1], [-0.5, height, 1]])
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.cam_from_world[:3, :3]
    image = center + depth * rays
    axes.plot(*image[[0, 1, 2, 3, 0]].T, color=color, linewidth=0.8)
    for corner in image:
        axes.plot(*np.stack([center, corner]).T, color=color, linewidth=0.5)
