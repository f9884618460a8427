"""A box around what cameras look at, where none is given."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import SceneError
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.ground import SupportingPlane, supporting_plane
from recon3d.scene.point_box import box_of_points
from recon3d.scene.view import View

PADDING = 0.03
"""Fraction of the longest side added around a box that was found."""

FROM_CAMERAS = "found from what most cameras see"
"""What a box was found from that holds the object and much else."""

_NO_TABLE = "no table or ground was recognised to leave out"
_N = 48  # cells along a side of the cube that is searched
_VIEWS = 60  # that are looked at, of many
_WHOLE = 0.5  # scale of a silhouette from which on cells are so small that their middles are looked at alone
_PARALLEL = 1e-3  # squared sine of the angle between axes below which they do not tell a distance


def enclosing_box(
    views: Sequence[View], points: NDArray[np.float64] | None = None, *, object_alone: bool = False
) -> tuple[Bounds, str]:
    """Box around the object and what it was found from: silhouettes, else points, else what most cameras see.

    Parameters
    ----------
    points : (n, 3) points of what the photographs show, world.
    object_alone : leave out the table or ground that the object stands on, where one is found among the points.

    Raises
    ------
    SceneError : the cameras look at no common place.
    """
    chosen = _some(views)
    middle, reach = _middle_and_reach(chosen)
    cube = Bounds(middle - reach, middle + reach)
    masked = [view for view in chosen if view.has_silhouette]
    if len(masked) >= min(2, len(chosen)):
        hull = _extent(cube, lambda box: _in_silhouettes(masked, box), rounds=3)
        if hull:
            told = f"found from the silhouettes of {len(masked)} views"
            return hull, f"{told}, which show the object alone" if object_alone else told
    if points is not None:
        plane = supporting_plane(points, chosen, middle, reach) if object_alone else None
        found = box_of_points(points, chosen, middle, reach, plane)
        if found:
            return found[0], f"{found[1]}; {_NO_TABLE}" if object_alone and plane is None else found[1]
    seen = _extent(cube, lambda box: _seen_by_most(chosen, box), rounds=2)
    if seen is None:
        raise SceneError("no place is in most of the photographs; give bounds")
    return seen, f"{FROM_CAMERAS}; {_NO_TABLE}" if object_alone else FROM_CAMERAS


def found_table(views: Sequence[View], points: NDArray[np.float64]) -> SupportingPlane | None:
    """The table or ground that the object stands on, found among points (n, 3) of the photographs, world; or None.

    Raises
    ------
    SceneError : the cameras look at no common place.
    """
    chosen = _some(views)
    return supporting_plane(points, chosen, *_middle_and_reach(chosen))


def _some(views: Sequence[View]) -> list[View]:
    return [views[n] for n in np.unique(np.linspace(0, len(views) - 1, min(_VIEWS, len(views))).round().astype(int))]


def _middle_and_reach(views: Sequence[View]) -> tuple[NDArray[np.float64], float]:
    """Where cameras look (3,), world, and half the side of a cube around it that no camera is inside."""
    middle = looked_at(views)
    return middle, 0.9 * min(float(np.abs(view.center - middle).max()) for view in views)


def looked_at(views: Sequence[View]) -> NDArray[np.float64]:
    """(3,) point nearest to the optical axes of all views, by least squares, world.

    Raises
    ------
    SceneError : the axes are parallel, or the point lies behind most cameras.
    """
    axes = np.array([view.cam_from_world[2, :3] for view in views])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] < _PARALLEL * len(views):
        raise SceneError("the cameras look in one direction, which does not tell how far the object is; give bounds")
    centers = np.array([view.center for view in views])
    middle = np.linalg.solve(total, np.einsum("nij,nj->i", across, centers))
    if np.median(np.einsum("ni,ni->n", middle - centers, axes)) <= 0:
        raise SceneError(
            "the point nearest to the cameras' optical axes lies behind most of them: are the matrices "
            "camera-to-world, or the axes not OpenCV's (x right, y down, z forward)?"
        )
    return np.asarray(middle)


def silhouettes_explained(views: Sequence[View], bounds: Bounds) -> NDArray[np.float64]:
    """(n,) share of each silhouette, inside the box, that what lies in all silhouettes can be seen in.

    1 for silhouettes of one object by right cameras, to the size of a cell, a 48th of the box; less where cameras and
    silhouettes are not each other's.

    Parameters
    ----------
    views : n, all with silhouettes.
    """
    held = bounds.grid(_N, _N, _N)[_in_silhouettes(views, bounds).ravel()]
    radius = 0.5 * float(np.linalg.norm(bounds.extent)) / _N
    shares = []
    for view in views:
        depth = view.project(bounds.center[None])[1][0]
        scale = min(1.0, max(max(depth, 1e-12) / view.K[0, 0] / radius, 8 / min(view.width, view.height)))
        mask = view.silhouette_at(scale)
        if mask is not None:
            camera = view.calibration.at(scale)
            corners, before = _projected(camera, bounds.corners)
            within = np.zeros(mask.shape, np.uint8)
            cv2.fillConvexPoly(within, cv2.convexHull(corners.astype(np.float32)).round().astype(np.int32), 1)
            shown = mask & (within > 0) if before.all() else mask
            shares.append(float((shown & _drawn(camera, held, radius)).sum() / max(shown.sum(), 1)))
    return np.array(shares)


def _projected(camera: Camera, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Pixels (n, 2) of world points, and which lie before the camera."""
    homogeneous = points @ (camera.K @ camera.cam_from_world[:3, :3]).T + camera.K @ camera.cam_from_world[:3, 3]
    before = homogeneous[:, 2] > 0
    return homogeneous[:, :2] / np.where(before, homogeneous[:, 2], 1)[:, None], before


def _drawn(camera: Camera, cells: NDArray[np.float64], radius: float) -> NDArray[np.bool_]:
    """(height, width) pixels that show cells of a radius, world units."""
    picture = np.zeros((camera.height, camera.width), np.uint8)
    pixels, before = _projected(camera, cells)
    u, v = pixels.round().astype(np.int64).T
    seen = before & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    if not seen.any():
        return picture > 0
    picture[v[seen], u[seen]] = 1
    depth = float(np.median((cells @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3])[seen]))
    reach = int(np.ceil(radius * camera.K[0, 0] / depth))
    return cv2.dilate(picture, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0


def _extent(cube: Bounds, holds: Callable[[Bounds], NDArray[np.bool_]], *, rounds: int) -> Bounds | None:
    """Padded box of the cells that hold the object, finer with every round; None where there are none.

    Parameters
    ----------
    holds : (n, n, n) which cells of a box do.
    """
    box = cube
    for _ in range(rounds):
        cells = np.argwhere(holds(box))
        if not len(cells):
            return None
        size = box.extent / _N
        low = np.maximum(box.low + (cells.min(axis=0) - 1) * size, cube.low)
        high = np.minimum(box.low + (cells.max(axis=0) + 2) * size, cube.high)
        box = Bounds(low, high)
    return box.padded(PADDING * box.longest)


def _in_silhouettes(views: Sequence[View], box: Bounds) -> NDArray[np.bool_]:
    """Which cells may be in all silhouettes; what fewer than half of the views show is not."""
    cells, left = np.ascontiguousarray(box.grid(_N, _N, _N).T), np.arange(_N**3)  # rows of x, y, z
    seen = np.zeros(len(left), np.int64)
    radius = 0.5 * float(np.linalg.norm(box.extent)) / _N
    for view in views:
        depth = view.project(box.center[None])[1][0]
        # A pixel of the small silhouette is as large as a cell, and may be object where anything that it covers may.
        scale = max(max(depth, 1e-12) / view.K[0, 0] / radius, 8 / min(view.width, view.height))
        scale = scale if scale < _WHOLE else 1.0
        mask = view.silhouette_at(scale)
        if mask is None:
            continue
        camera = view.calibration.at(scale)
        P = camera.K @ camera.cam_from_world[:3]
        u, v, away = P[:, :3] @ cells + P[:, 3:]
        within = away > 0
        for place, side in ((u, camera.width), (v, camera.height)):
            np.divide(place, away, out=place, where=within)
            within &= (place >= -0.5) & (place < side - 0.5)
        shown = (_grown(mask) if scale < 1 else mask)[
            np.rint(v[within]).astype(np.intp), np.rint(u[within]).astype(np.intp)
        ]
        seen += within
        within[within] = ~shown
        if within.any():  # outside the silhouette
            cells, left, seen = cells[:, ~within], left[~within], seen[~within]
    held = np.zeros(_N**3, np.bool_)
    held[left[seen >= len(views) / 2]] = True
    return held.reshape(_N, _N, _N)


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask and the pixels next to it."""
    padded = np.pad(mask, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def _seen_by_most(views: Sequence[View], box: Bounds) -> NDArray[np.bool_]:
    """Which cells as many views see as any, but for a tenth."""
    counts = np.sum([view.sees(box.grid(_N, _N, _N)) for view in views], axis=0)
    return np.asarray((counts >= max(0.9 * counts.max(), 1)).reshape(_N, _N, _N))
