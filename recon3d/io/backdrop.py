"""What a scene without masks shows behind its object: a backdrop of about one color, or more."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from recon3d.errors import SceneError
from recon3d.scene.background import BLACK, background_color, foreground, has_plain_frame
from recon3d.scene.enclosing import enclosing_box
from recon3d.scene.regions import bounds_mask
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.view import View

_CHECKED = 8e6  # pixels that are looked at to check a box
_FEWEST = 3  # views that are looked at, however large
_LONG_SIDE = 400  # pixels, of reduced photographs that an object is cut out of to find its box
_MOST = 60  # of them
_LIT = 0.1  # of the pixels outside the box, that may be bright on a dark background


def _looked_at(scene: Scene) -> list[View]:
    """Some views of many, evenly chosen, to judge all by."""
    n = len(scene.views)
    pixels = sum(view.width * view.height for view in scene.views) / n
    count = int(np.clip(_CHECKED / pixels, min(_FEWEST, n), n))
    return [scene.views[k] for k in np.linspace(0, n - 1, count).round().astype(int)]


def before_backdrop(scene: Scene) -> bool:
    """Whether half of the photographs or more show an object before a background of about one color."""
    return bool(np.mean([has_plain_frame(view.image) for view in _looked_at(scene)]) >= 0.5)


def check_foreground(scene: Scene, *, must_fit: bool, dark: bool = False, otherwise: str = "") -> bool:
    """Refuse a box that cuts an object on a background of one color off, or warn of it; looks at some of many views.

    Parameters
    ----------
    dark : the background must be dark.
    otherwise : end of the warning.

    Returns
    -------
    Whether nothing was found to be wrong.
    """
    shares, lit = [], []
    chosen = _looked_at(scene)
    color = BLACK if dark else background_color(chosen, scene.bounds)
    for view in chosen:
        bright = foreground(view.image, color=color)
        within = bounds_mask(scene.bounds, view)
        held, all_bright, beside = (int(np.count_nonzero(mask)) for mask in (bright & within, bright, ~within))
        shares.append(held / max(all_bright, 1))
        lit.append((all_bright - held) / max(beside, 1))
    # A box that fills the image holds what stands out though the little beside it is no plain background.
    if np.median(shares) >= 0.9 and (must_fit or np.median(lit) <= _LIT):
        return True
    stands_out = "is bright" if color == BLACK else f"is not of the background's color {color}"
    message = (
        f"{scene.name}: the bounding box holds {100 * np.median(shares):.0f}% of what {stands_out} in the median "
        f"image, and {100 * np.median(lit):.0f}% of the pixels outside it are so. Is this another set's box (every set "
        "has its own world frame), or a background that is not dark, nor of one color? For that give silhouettes as a "
        "folder of masks, or none"
    )
    if must_fit:
        raise SceneError(message)
    warnings.warn(message + otherwise, stacklevel=3)
    return False


def with_box_of_foreground(scene: Scene) -> Scene:
    """The scene with a box around what stands out from a background of one color, in small copies of the photographs.

    For boxes that are no more than what all cameras see. Where nothing stands out, the box stays.
    """
    n = len(scene.views)
    views = []
    for k in np.unique(np.linspace(0, n - 1, min(n, _MOST)).round().astype(int)):
        view = scene.views[k]
        scale = min(1.0, _LONG_SIDE / max(view.width, view.height))
        views.append(View(view.calibration.at(scale), view.image_at(scale), None, view.name))
    cut_out = with_segmented_silhouettes(replace(scene, views=tuple(views)))
    box, how = enclosing_box(cut_out.views)
    if "silhouettes" not in how:
        return scene
    return replace(scene, bounds=box, notes={**scene.notes, "bounds": f"{box.text}, {how}"})
