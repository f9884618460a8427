"""Whether the box is around what the photographs show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.finding import Finding
from recon3d.scene.bounds import Bounds
from recon3d.scene.ground import TABLE_LEFT_OUT
from recon3d.scene.scene import Scene

_FEWEST = 60  # points
_OUTSIDE, _INSIDE = 0.25, 0.8  # shares of the points inside a box that is wrong, and right
_LARGE, _SMALL = 20.0, 0.2  # times the extent of the points
_UNITS = (0.001, 1000.0, 0.01, 100.0, 0.0254, 1 / 0.0254, 25.4, 1 / 25.4)
_TOLD = {0.001: "1000 times too large", 1000.0: "1000 times too small"}


def box_findings(scene: Scene, points: NDArray[np.float64]) -> list[Finding]:
    """What is wrong with the bounds by points (n, 3) that were matched, world; of fewer than 60, the cameras alone."""
    alone = TABLE_LEFT_OUT in scene.notes.get("bounds", "")  # then most points may be the table's
    found = _by_points(scene.bounds, points) if len(points) >= _FEWEST and not alone else None
    return [found] if found else _cameras_inside(scene)


def _by_points(box: Bounds, points: NDArray[np.float64]) -> Finding | None:
    low, high = np.percentile(points, [10, 90], axis=0)
    spread = max(float((high - low).max()), 1e-12)
    ratio, inside = box.longest / spread, _share(box, points)
    if inside >= _OUTSIDE and ratio <= _LARGE:
        return None
    where = Bounds(*np.percentile(points, [2, 98], axis=0)).text
    for factor in _UNITS:
        scaled = Bounds(factor * np.array(box.low), factor * np.array(box.high))
        if _share(scaled, points) >= _INSIDE and 1 <= scaled.longest / spread <= 4:
            return Finding(
                "unit",
                f"The bounds are in another unit than the cameras: {_TOLD.get(factor, f'times {factor:.4g}')}"
                f"{'' if factor in _TOLD else ' they hold what the photographs show'} (matched points lie in {where}).",
                f"Multiply the bounds by {factor:g}, or the cameras' t by {1 / factor:g}.",
            )
    advice = f"Give bounds around the object, such as {where}, or leave them out to have them found."
    if ratio > _LARGE:
        return Finding(
            "huge box",
            f"The bounds are {ratio:.0f} times as long as what the photographs show: few voxels would be left for it.",
            advice,
        )
    if ratio < _SMALL:
        return Finding(
            "tiny box",
            f"The bounds hold {inside:.0%} of the matched points, and are {1 / ratio:.0f} times shorter than their "
            "extent.",
            advice,
        )
    return Finding("wrong box", f"The bounds hold only {inside:.0%} of the matched points.", advice)


def _cameras_inside(scene: Scene) -> list[Finding]:
    """That cameras stand inside the bounds, which a room may want."""
    box = scene.bounds
    within = np.asarray((np.abs(scene.centers - box.center) < box.extent / 2).all(axis=1))
    names = tuple(view.name for view, inside in zip(scene.views, within, strict=True) if inside)
    if not names:
        return []
    return [
        Finding(
            "cameras inside the box",
            f"{len(names)} of {len(scene.views)} cameras stand inside the bounds ({', '.join(names[:3])}).",
            "That is right for a room seen from within; else give bounds around the object alone.",
            names,
        )
    ]


def _share(box: Bounds, points: NDArray[np.float64]) -> float:
    wider = box.padded(0.05 * box.longest)
    return float(((points > wider.low) & (points < wider.high)).all(axis=1).mean())
