"""Holes in a mask that the other masks, and the colors there, contradict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.view import View
from recon3d.values import Once

FEWEST_MASKS = 4
"""That can contradict one."""

_N = 64  # cells along the longest side of the bounds
_CELL = 4  # pixels of the reduced masks that a cell is wide
_OTHERS = 3  # views, or more, whose masks call a cell object; as many are asked for its color
_AGREEING = 2  # of those
_ALIKE = 25  # grey levels between colors of one thing
_CLOSER = 0.5  # times the difference from the background: colors of one thing are that close
_WIDTH = 0.6  # cells that a hole is wide to either side of its middle, at least
_PIXELS = 2.0  # the same in pixels: outlines are not exact
_OBLIQUE = 0.5  # cosine of the angle between views from which on colors are not compared
_SURE = 0.5  # share of a hole that the colors must call object


def contradicted_holes(
    views: Sequence[View], bounds: Bounds, background: tuple[int, int, int]
) -> dict[int, NDArray[np.bool_]]:
    """Pixels (height, width) that a mask wrongly leaves out, by the numbers of the views.

    All other masks that see a hole's rays call a part of them object. That alone is no contradiction: one view alone
    may look through a narrow gap. But where what it sees there has the color that the nearest other views see on those
    rays, it sees the same surface, which is object by their masks. Gaps show the background to one view and the object
    to the others. What is of the background's own color cannot be told from it. Holes narrower than a cell, of 64
    along the longest side of the bounds, are not found.

    Parameters
    ----------
    views : with masks, of one object; in fewer than four nothing is found.
    background : its color, RGB, 0 to 255.
    """
    if len(views) < FEWEST_MASKS:
        return {}
    size = bounds.longest / _N
    reduced = [_Reduced.of(view, bounds.center, size) for view in views]
    cells, excluding = _excluded_by_one(reduced, bounds, size)
    found = {}
    for n, view in enumerate(views):
        parts = _wide_parts(reduced[n], cells[excluding == n])
        hole = _of_one_surface(reduced, n, background, *parts) if parts else None
        if hole is not None:
            found[n] = _at_full_size(hole, view, reduced[n])
    return found


@dataclass(frozen=True, eq=False)
class _Reduced:
    """A view at which a cell is about four pixels wide, or less where the photograph is that small."""

    camera: Camera
    mask: NDArray[np.bool_]
    """(height, width)"""
    cell: float
    """Width of a cell in the middle of the bounds, pixels."""
    read: Callable[[], NDArray[np.uint8]]
    _image: Once[NDArray[np.uint8]] = field(default_factory=Once, init=False)

    @classmethod
    def of(cls, view: View, center: NDArray[np.float64], size: float) -> _Reduced:
        """A view's, cells of a size being about a center (3,), world."""
        depth = max(float(view.project(center[None])[1][0]), 1e-9)
        width = size * view.K[0, 0] / depth
        scale = min(1.0, max(_CELL / width, 8 / min(view.width, view.height)))
        mask = view.silhouette_at(scale)
        camera = view.calibration.at(scale)
        shown = np.ones((camera.height, camera.width), np.bool_) if mask is None else mask
        return cls(camera, shown, scale * width, lambda: np.asarray(cv2.blur(view.image_at(scale), (3, 3)), np.uint8))

    @property
    def image(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB, blurred a little."""
        return self._image.get(self.read)

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) camera centre, world."""
        return np.asarray(-self.camera.cam_from_world[:3, :3].T @ self.camera.cam_from_world[:3, 3])

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Nearest pixels (n, 2) of world points as (u, v), and which (n,) are in the image; (0, 0) for the others."""
        P = self.camera.K @ self.camera.cam_from_world[:3]
        x, y, depth = P[:, :3] @ points.T + P[:, 3:]
        front = depth > 0
        depth[~front] = np.inf
        u, v = np.rint(x / depth).astype(np.int64), np.rint(y / depth).astype(np.int64)
        seen = front & (u >= 0) & (v >= 0) & (u < self.camera.width) & (v < self.camera.height)
        u[~seen], v[~seen] = 0, 0
        return np.stack([u, v], axis=1), seen


def _excluded_by_one(
    views: Sequence[_Reduced], bounds: Bounds, size: float
) -> tuple[NDArray[np.float64], NDArray[np.int16]]:
    """Middles (n, 3) of the cells that one mask alone excludes, and the number (n,) of its view."""
    shape = [int(n) for n in np.ceil(bounds.extent / size)]
    cells = np.array(bounds.low) + size * (np.indices(shape).reshape(3, -1).T.astype(np.float64) + 0.5)
    excluding, n_seen = np.full(len(cells), -1, np.int16), np.zeros(len(cells), np.int16)
    for n, view in enumerate(views):
        pixels, seen = view.project(cells)
        excluded = seen & ~view.mask[pixels[:, 1], pixels[:, 0]]
        left = ~(excluded & (excluding >= 0))
        excluding[excluded] = n
        n_seen += seen
        cells, excluding, n_seen = cells[left], excluding[left], n_seen[left]
    alone = (excluding >= 0) & (n_seen > _OTHERS)
    return cells[alone], excluding[alone]


def _wide_parts(
    view: _Reduced, cells: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32], list[int]] | None:
    """What cells (n, 3) cover beside a mask, in connected parts that are wider than a cell.

    Returns
    -------
    The cells of the parts, a picture (height, width) of the parts' numbers, and the numbers; None where there are none.
    """
    if not len(cells):
        return None
    beside = np.asarray(_drawn(view, cells) & ~view.mask, np.uint8)
    inwards = np.asarray(cv2.distanceTransform(beside, cv2.DIST_L2, 5), np.float64)
    count, found = cv2.connectedComponents(beside, connectivity=4)
    labels, widths = np.asarray(found, np.int32), np.zeros(count)
    np.maximum.at(widths, labels.ravel(), inwards.ravel())
    numbers = [int(part) for part in np.flatnonzero(widths > max(_WIDTH * view.cell, _PIXELS))]
    u, v = view.project(cells)[0].T
    chosen = np.isin(labels[v, u], numbers)
    return (cells[chosen], labels, numbers) if numbers else None


def _of_one_surface(
    views: Sequence[_Reduced],
    n: int,
    background: tuple[int, int, int],
    cells: NDArray[np.float64],
    labels: NDArray[np.int32],
    numbers: list[int],
) -> NDArray[np.bool_] | None:
    """The parts, in view n, most of whose rays meet a cell that has one color in view n and in the nearest views."""
    own = _toward(views[n], cells)
    cosines = np.stack(
        [np.where(view.project(cells)[1], (_toward(view, cells) * own).sum(axis=1), -1.0) for view in views]
    )
    cosines[n] = -np.inf
    color = _colors(views[n], cells)
    off = np.abs(color - np.array(background)).max(axis=1)
    alike = np.minimum(_ALIKE, _CLOSER * off)
    agreeing = np.zeros(len(cells), np.int64)
    for nearest in np.argsort(-cosines, axis=0)[:_OTHERS]:
        for k in np.unique(nearest):
            asked = (nearest == k) & (cosines[k] > _OBLIQUE)
            agreeing[asked] += np.abs(_colors(views[k], cells[asked]) - color[asked]).max(axis=1) < alike[asked]
    sure = cells[agreeing >= _AGREEING]
    if not len(sure):
        return None
    covered = _drawn(views[n], sure)
    wrong = [part for part in numbers if covered[labels == part].mean() >= _SURE]
    return np.isin(labels, wrong) if wrong else None


def _toward(view: _Reduced, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) unit vectors from a camera to points."""
    rays = points - view.center
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _colors(view: _Reduced, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 3) what a view shows at points, 0 to 255."""
    u, v = view.project(points)[0].T
    return np.asarray(view.image[v, u], np.int64)


def _drawn(view: _Reduced, cells: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(height, width) pixels that cells cover, closed between neighbours."""
    picture = np.zeros(view.mask.shape, np.uint8)
    pixels, seen = view.project(cells)
    u, v = pixels[seen].T
    picture[v, u] = 1
    side = 2 * int(np.ceil(0.5 * view.cell)) + 1
    return cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8)) > 0


def _at_full_size(hole: NDArray[np.bool_], view: View, reduced: _Reduced) -> NDArray[np.bool_]:
    """(height, width) of a view: a hole, and what lies beside it closer to the mask than a cell."""
    large = np.asarray(cv2.resize(hole.view(np.uint8), (view.width, view.height), interpolation=cv2.INTER_NEAREST)) > 0
    mask = view.silhouette
    if mask is None:
        return large
    side = 2 * int(np.ceil(reduced.cell * view.width / reduced.camera.width)) + 1
    square = np.ones((side, side), np.uint8)
    closed = np.asarray(cv2.morphologyEx((large | mask).view(np.uint8), cv2.MORPH_CLOSE, square)) > 0
    near = np.asarray(cv2.dilate(large.view(np.uint8), square)) > 0
    return np.asarray((large | (closed & near)) & ~mask)
