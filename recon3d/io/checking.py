"""Whether cameras, photographs and masks of a scene are each other's."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon3d.errors import SceneError, SceneWarning
from recon3d.io.calibrated import Calibrated
from recon3d.scene.bounds import Bounds
from recon3d.scene.enclosing import silhouettes_explained
from recon3d.scene.image_file import ImageFile
from recon3d.scene.not_seen import why_not_seen
from recon3d.scene.photograph import Photograph
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_PIXELS = 3e7  # of masks that are looked at
_FEWEST = 4  # views, however large
_EXPLAINED = 0.97  # of the silhouettes, on average
_FACTORS = (8, 4, 3, 2, 1 / 2, 1 / 3, 1 / 4, 1 / 8)
_BITS = (8, 10, 12, 14, 16)
_OFF, _APART = 0.2, 0.12  # of the image's sides
_LEAST_SEEN, _NEARLY_ALL = 0.25, 0.9  # of a box's volume, in the median view
_OFF_CENTER = 0.5  # of the way from the image's middle to its border
_PROBES = 6  # along each side of a box


def with_one_white(found: Calibrated) -> Calibrated:
    """Photographs of 16 bits with the white that all share: 65535, or that of the fewer bits that they use.

    A few are looked at: cameras of 10, 12 or 14 bits store their values in 16 without scaling them.
    """
    deep = [image.photograph.source for image in found.images if isinstance(image.photograph.source, ImageFile)]
    deep = [file for file in deep if file.is_deep]
    if not deep:
        return found
    n = int(np.clip(_PIXELS / np.prod(deep[0].size), min(_FEWEST, len(deep)), len(deep)))
    largest = max(deep[k].largest() for k in np.linspace(0, len(deep) - 1, n).round().astype(int))
    bits = next(bits for bits in _BITS if largest < 2**bits)
    images = [
        image._replace(photograph=Photograph(replace(image.photograph.source, white=2**bits - 1)))
        if isinstance(image.photograph.source, ImageFile) and image.photograph.source.is_deep
        else image
        for image in found.images
    ]
    notes = (
        found.notes if bits == _BITS[-1] else {**found.notes, "values": f"{bits} bits in 16: {2**bits - 1} is white"}
    )
    return replace(found, images=tuple(images), notes=notes)


def told_of_another_size(views: Sequence[View]) -> str | None:
    """What tells that K is of photographs of another size, or None: principal points far out, in both directions."""
    places = np.median([(view.K[:2, 2] + 0.5) / (view.width, view.height) for view in views], axis=0)
    place = float(places.mean())
    if np.abs(places - 0.5).min() < _OFF or np.ptp(places) > _APART * 2 * place:
        return None
    factor = min(_FACTORS, key=lambda factor: abs(np.log(2 * place / factor)))
    if abs(np.log(2 * place / factor)) > _OFF:
        return None
    u, v = views[0].K[:2, 2]
    times = f"{factor:g} times as large" if factor > 1 else f"1/{1 / factor:g} as large"
    return (
        f"the principal point of {views[0].name} is ({u:.4g}, {v:.4g}) in an image of "
        f"{views[0].width}x{views[0].height} pixels: K looks like that of photographs {times}. Give those, or scale K"
    )


def warn_of_silhouettes(scene: Scene) -> None:
    """Warn of silhouettes that are not of one object, as of cameras and photographs in different orders."""
    masked = [view for view in scene.views if view.has_silhouette]
    if len(masked) < _FEWEST:
        return
    n = int(np.clip(_PIXELS / np.mean([view.width * view.height for view in masked]), _FEWEST, len(masked)))
    chosen = [masked[k] for k in np.linspace(0, len(masked) - 1, n).round().astype(int)]
    share = float(silhouettes_explained(chosen, scene.bounds).mean())
    if share < _EXPLAINED:
        message = (
            f"{scene.name}: the silhouettes contradict each other: what lies in all of them fills only "
            f"{100 * share:.0f}% of the average one. Are cameras and photographs in the same order, "
            "the masks those of these views, the calibration exact?"
        )
        warnings.warn(SceneWarning(message, "masks"), stacklevel=4)


def check_box(scene: Scene) -> None:
    """Refuse a box that is not in the images, as another set's frame would have it; warn of cameras inside it."""
    box = scene.bounds
    inside = [view.name for view in scene.views if (np.abs(view.center - box.center) < box.extent / 2).all()]
    told = (
        f"{len(inside)} of {len(scene.views)} cameras stand inside the bounding box ({', '.join(inside[:1])}): "
        "give bounds around the object alone, not the room"
    )
    if wrong := not_in_images(scene.views, box):
        question = told_of_another_size(scene.views) or why_not_seen(scene.views, box)
        question = told if inside else question or "Every set has its own world frame: is this another set's box?"
        raise SceneError(f"{scene.name}: {wrong}. {question[0].upper()}{question[1:]}")
    if inside:
        warnings.warn(SceneWarning(f"{scene.name}: {told}", "bounds"), stacklevel=3)
    if scaled := told_of_another_size(scene.views):
        warnings.warn(SceneWarning(f"{scene.name}: {scaled}", "cameras"), stacklevel=3)


def not_in_images(views: tuple[View, ...], box: Bounds) -> str | None:
    """How a box is not what the images show, or None."""
    steps = (np.arange(_PROBES) + 0.5) / _PROBES
    probes = box.low + np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3) * box.extent
    seen = [float(view.sees(probes).mean()) for view in views]
    share, off = np.median(seen), np.median([_off_center(view, box) for view in views])
    # An object that fills the frame leaves it on all sides; another set's box leaves it on one.
    if share >= _LEAST_SEEN and (share >= _NEARLY_ALL or off <= _OFF_CENTER):
        return None
    worst = int(np.argmin(seen))
    return (
        "expected the bounding box in the middle of most images, or most of it inside, got "
        f"{100 * share:.0f}% of it inside the median image ({views[worst].name}: {100 * seen[worst]:.0f}%)"
    )


def _off_center(view: View, box: Bounds) -> float:
    """How far from the image's middle a box's middle is, 0 to 1 at the image's border; behind the camera: infinite."""
    pixels, depth = view.project(box.center[None])
    half = np.array([view.width, view.height]) / 2
    return float(np.abs((pixels[0] + 0.5) / half - 1).max()) if depth[0] > 0 else np.inf
