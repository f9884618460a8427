"""Sheets of pictures: renderings beside photographs, and turns around an object."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.rendering.orbit import _orbit, up_direction
from recon3d.rendering.renderer import Renderer
from recon3d.scene.scene import Scene
from recon3d.scene.view import View


def comparison_sheet(scene: Scene, renderer: Renderer, *, views: int = 4, width: int = 320) -> NDArray[np.uint8]:
    """(height, width, 3) RGB sheet: photograph, colours, shading, normals and depth of some evenly chosen views."""
    chosen = np.unique(np.linspace(0, len(scene.views) - 1, min(views, len(scene.views))).round().astype(int))
    rows = []
    for n in chosen:
        view = scene.views[n]
        rendering = renderer.render_view(view)
        pictures = [view.image, *rendering.pictures().values()]
        height = max(1, round(view.height * width / view.width))
        rows.append(np.hstack([cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in pictures]))
    return np.vstack(rows)


def turntable(
    scene: Scene | None, renderer: Renderer, *, frames: int = 8, size: int = 320, mode: str = "colored"
) -> NDArray[np.uint8]:
    """(height, width, 3) RGB strip of the mesh seen from all around, about the axis that the cameras stand around.

    Without a scene, about the longest side of the mesh's box.
    """
    extent = renderer.mesh.get_max_bound() - renderer.mesh.get_min_bound()
    up = np.eye(3)[int(extent.argmax())] if scene is None else up_direction(scene)
    center = renderer.mesh.get_axis_aligned_bounding_box().get_center()
    radius = float(np.linalg.norm(extent)) / 2
    pictures = [
        renderer.render(*camera, 2 * size, 2 * size).picture(mode)
        for camera in _orbit(center, radius, up, frames, 2 * size)
    ]
    return np.hstack([cv2.resize(p, (size, size), interpolation=cv2.INTER_AREA) for p in pictures])


def portrait(picture: NDArray[np.uint8], view: View, scene: Scene) -> NDArray[np.uint8]:
    """A picture (height, width, 3) from a view's camera, cut to the scene's bounds and turned by quarters, upright."""
    corners, depths = view.project(scene.bounds.corners)
    if (depths > 0).all():
        size = np.array([view.width, view.height])
        low = np.clip(np.floor(corners.min(axis=0)), 0, size - 1).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0)), low, size - 1).astype(int)
        picture = picture[low[1] : high[1] + 1, low[0] : high[0] + 1]
    center = scene.bounds.center
    ends, _ = view.project(np.stack([center, center + 0.1 * scene.bounds.longest * up_direction(scene)]))
    right, down = ends[1] - ends[0]
    if abs(right) > abs(down):
        return np.rot90(picture, 1 if right > 0 else 3)
    return np.rot90(picture, 2 if down > 0 else 0)
