"""Holes in masks that the other masks, and the colors there, contradict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recon3d.diagnosis.finding import Finding
from recon3d.diagnosis.matches import LONG_SIDE, Picture
from recon3d.scene.background import background_color
from recon3d.scene.mask_holes import contradicted_holes
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import filled_holes
from recon3d.scene.view import View

_NAMED = 4


def hole_findings(scene: Scene, pictures: Sequence[Picture]) -> list[Finding]:
    """Holes in masks that are given, and those that were filled in masks made of the photographs, by right cameras."""
    return [*_in_given(scene, pictures), *_in_segmented(scene)]


def _in_given(scene: Scene, pictures: Sequence[Picture]) -> list[Finding]:
    masked = [picture for picture in pictures if picture.mask is not None]
    views = [View(picture.camera, picture.image, picture.mask, picture.view.name) for picture in masked]
    if not views:
        return []
    found = contradicted_holes(views, scene.bounds, background_color(views, scene.bounds))
    if not found:
        return []
    names = tuple(views[n].name for n in found)
    places = [f"{views[n].name} near pixel {_place(hole, masked[n])}" for n, hole in found.items()]
    told = "; ".join(places[:_NAMED]) + (f"; and {len(places) - _NAMED} more" if len(places) > _NAMED else "")
    which = "The mask of one view has a hole" if len(names) == 1 else f"The masks of {len(names)} views have holes"
    return [
        Finding(
            "holes in masks",
            f"{which} that all other masks, and the colors there, contradict: {told}. Nothing is changed, and such a "
            "hole bores a tunnel through the object.",
            "Fill it in the mask, or leave the mask out.",
            names,
        )
    ]


def _in_segmented(scene: Scene) -> list[Finding]:
    filled = filled_holes(scene.views, min(1.0, LONG_SIDE / max(max(view.width, view.height) for view in scene.views)))
    if not filled:
        return []
    return [
        Finding(
            "filled holes",
            f"What tells the object from its background left holes that all other silhouettes, and the colors there, "
            f"contradict; they are filled: {', '.join(filled[:_NAMED])}{' ...' * (len(filled) > _NAMED)}.",
            "Look at the silhouettes (recon3d info --output DIR); others can be given (--silhouettes FOLDER).",
            tuple(filled),
        )
    ]


def _place(hole: NDArray[np.bool_], picture: Picture) -> str:
    """The middle of a hole (height, width) of a reduced photograph as u, v of the photograph itself."""
    v, u = np.median(np.argwhere(hole), axis=0) * picture.view.width / picture.camera.width
    return f"{u:.0f},{v:.0f}"
