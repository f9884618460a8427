"""Scenes from folders of calibrated photographs, whatever their format."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d

from recon3d.errors import DataError, SceneError
from recon3d.io.calibrated import Calibrated
from recon3d.io.middlebury import is_middlebury, read_middlebury
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import (
    bounds_mask,
    foreground,
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
)
from recon3d.scene.view import View


class Format(NamedTuple):
    """How a scene format is recognised and read."""

    recognises: Callable[[Path], bool]
    read: Callable[[Path], Calibrated]
    sign: str


FORMATS: dict[str, Format] = {
    "middlebury": Format(is_middlebury, read_middlebury, "a folder with a *_par.txt (Middlebury)"),
}

_MADE = {
    "auto": with_segmented_silhouettes,
    "segmented": with_segmented_silhouettes,
    "threshold": with_threshold_silhouettes,
}

_CHECKED = 8e6  # pixels that are looked at to check a box
_FEWEST = 3  # views that are looked at, however large


def open_scene(
    path: Path | str,
    *,
    bounds: Bounds | o3d.geometry.AxisAlignedBoundingBox | None = None,
    silhouettes: str | Path = "auto",
    mm_per_unit: float | None = None,
) -> Scene:
    """Open a folder of calibrated photographs, whatever its format; pixels are read when they are asked for.

    Parameters
    ----------
    bounds : the object's box in the scene's own world frame; the scene's own when None.
    silhouettes : "auto": the scene's own masks where it has some, else "segmented"; "segmented" or "threshold": made
        from a dark background, by GrabCut or by the recipe of dinoSparseRing's README, of all views or of those that
        the scene says have good ones; "none"; or a folder of masks.
    mm_per_unit : millimetres in one world unit; what the format says, or 1000 (metres), when None.

    Raises
    ------
    DataError : nothing there, of no known format, or a file is missing or malformed; names file and line.
    SceneError : the box does not fit the cameras or cuts the object off.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    known = next((known for known in FORMATS.values() if known.recognises(path)), None)
    if known is None:
        raise DataError(f"{path}: not a known scene; expected {' or '.join(known.sign for known in FORMATS.values())}")
    found = known.read(path)
    box = found.bounds if bounds is None else Bounds.of(bounds)
    if box is None:
        raise DataError(found.no_bounds)
    named = str(silhouettes) not in (*_MADE, "none")
    scene = Scene(
        tuple(View(image.camera, image.photograph, None, image.name) for image in found.images),
        box,
        found.name,
        found.mm_per_unit if mm_per_unit is None else mm_per_unit,
        {
            **found.notes,
            "source": str(path.resolve()),
            "silhouettes from": str(Path(silhouettes).resolve() if named else silhouettes),
        },
    )
    _check_box(scene)
    if silhouettes == "none":
        return scene
    if named:
        return with_mask_files(scene, silhouettes)
    if silhouettes == "auto" and found.masks is not None:
        return with_mask_files(scene, found.masks, only=found.masked)
    _check_foreground(scene, must_fit=bounds is None)
    return _MADE[str(silhouettes)](scene, only=found.masked)


def _check_box(scene: Scene) -> None:
    """Refuse a box that leaves the images, as another set's frame would have it."""
    seen = scene.corners_in_views()
    if np.median(seen) < 4:
        worst = int(np.argmin(seen))
        raise SceneError(
            f"{scene.name}: expected at least 4 of the bounding box's 8 corners inside most images, got a median of "
            f"{np.median(seen):g} ({scene.views[worst].name}: {seen[worst]}). Every set has its own world frame: is "
            "this another set's box?"
        )


def _check_foreground(scene: Scene, *, must_fit: bool) -> None:
    """Refuse a box that cuts a bright object on a dark background off, or warn of it; looks at some of many views."""
    n = len(scene.views)
    pixels = sum(view.width * view.height for view in scene.views) / n
    looked_at = int(np.clip(_CHECKED / pixels, min(_FEWEST, n), n))
    shares = []
    for view in (scene.views[k] for k in np.linspace(0, n - 1, looked_at).round().astype(int)):
        bright = foreground(view.image)
        held, all_bright = (int(np.count_nonzero(mask)) for mask in (bright & bounds_mask(scene.bounds, view), bright))
        shares.append(held / max(all_bright, 1))
    if np.median(shares) < 0.9:
        message = (
            f"{scene.name}: the bounding box holds only {100 * np.median(shares):.0f}% of the bright pixels of the "
            "median image. Is this another set's box (every set has its own world frame), or a background that is not "
            "dark? For that give silhouettes as a folder of masks, or none"
        )
        if must_fit:
            raise SceneError(message)
        warnings.warn(message, stacklevel=3)
