"""Whether cameras, photographs and masks of a scene are each other's."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon3d.io.calibrated import Calibrated
from recon3d.scene.enclosing import silhouettes_explained
from recon3d.scene.image_file import ImageFile
from recon3d.scene.photograph import Photograph
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_PIXELS = 3e7  # of masks that are looked at
_FEWEST = 4  # views, however large
_EXPLAINED = 0.97  # of the silhouettes, on average
_FACTORS = (8, 4, 3, 2, 1 / 2, 1 / 3, 1 / 4, 1 / 8)
_BITS = (8, 10, 12, 14, 16)
_OFF, _APART = 0.2, 0.12  # of the image's sides


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
        warnings.warn(
            f"{scene.name}: the silhouettes contradict each other: what lies in all of them fills only "
            f"{100 * share:.0f}% of the average one. Are cameras and photographs in the same order, "
            "the masks those of these views, the calibration exact?",
            stacklevel=4,
        )
