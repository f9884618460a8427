"""Which image files are the masks of which views, by their names."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from recon3d.errors import DataError
from recon3d.scene.camera import same_shape
from recon3d.scene.heic import HEIC_SUFFIXES
from recon3d.scene.image_file import ImageFile
from recon3d.scene.mask import FileMask
from recon3d.scene.view import View

IMAGE_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".jpe", ".jp2", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".pbm", ".pnm", ".webp", ".gif"}
    | HEIC_SUFFIXES
)
"""In lower case."""

_LOOKED_AT = 5  # masks
_RIM_SHARE, _MIDDLE_SHARE = 0.75, 0.25  # of the pixels at the border and in the middle, in inverted masks
_FOLDERS = frozenset({"mask", "masks", "silhouette", "silhouettes"})
_MARK = re.compile(r"(^|[._-])(mask|silhouette|sil)s?(?=$|[._-])", re.IGNORECASE)


def mask_folders(beside: Iterable[Path]) -> list[Path]:
    """Folders of masks under their usual names: mask, masks, silhouette, silhouettes, in upper case or lower."""
    places = (sorted(place.iterdir()) if place.is_dir() else [] for place in dict.fromkeys(beside))
    found = (entry for place in places for entry in place if entry.name.casefold() in _FOLDERS and entry.is_dir())
    return list(dict.fromkeys(found))


def names_a_mask(path: Path) -> bool:
    """Whether a file's own name says that it is a mask: ``001.mask.png``, ``001_mask.png``."""
    return _MARK.search(path.stem) is not None


def masks_of_views(
    views: Sequence[View], stems: Iterable[str], folder: Path, *, marked: bool = False
) -> dict[str, Path]:
    """Files in a folder that are masks of views, by the views' names; those without one are left out.

    For a view ``a/001.png`` that is ``a/001.png.*`` or ``a/001.*``, the same with "mask" or "silhouette" in it
    (``a/001.mask.*``, ``a/001_mask.*``), ``a_001.*``, the name that the view's own files are written under, or, where
    names are plain numbers, one of the same number. Where no two views have a name ``001.png`` in different folders,
    ``001.*`` will do, too.

    Parameters
    ----------
    stems : of each view, what its own files are called.
    marked : only files whose names say that they are masks, as in the folder of the photographs themselves.

    Raises
    ------
    DataError : two files might be the mask of one view.
    """

    @cache
    def listed(place: Path) -> list[Path]:
        files = sorted(place.iterdir()) if place.is_dir() else []
        return [path for path in files if path.suffix.lower() in IMAGE_SUFFIXES and (not marked or names_a_mask(path))]

    last = Counter(Path(view.name).stem for view in views)
    found: dict[str, Path] = {}
    for view, stem in zip(views, stems, strict=True):
        own = Path(view.name)
        within = not own.is_absolute() and ".." not in own.parts
        near = listed((folder / own).parent) if within else []
        ways = (
            *([path for path in near if _plain(path.stem) == name] for name in _names(own)),
            [path for path in listed(folder) if path.stem == stem],
            [path for path in listed(folder) if last[own.stem] == 1 and _plain(path.stem) in _names(own)],
            [path for path in near if own.stem.isdecimal() and _number(path) == int(own.stem)],
        )
        files = next((files for files in ways if files), [])
        if len(files) > 1 or len(ways[0]) + len(ways[1]) > 1:
            both = sorted({path.name for path in (*ways[0], *ways[1], *files)})
            raise DataError(f"{folder}: expected one mask for view {view.name}, found {len(both)}: {', '.join(both)}")
        if files:
            found[view.name] = files[0]
    return found


def _names(own: Path) -> tuple[str, str]:
    """What a view's mask may be called: its name, or that without its ending."""
    return own.name.casefold(), own.stem.casefold()


def _plain(stem: str) -> str:
    """A stem without what says that it is a mask."""
    return _MARK.sub("", stem).casefold()


def _number(path: Path) -> int | None:
    return int(plain) if (plain := _plain(path.stem)).isdecimal() else None


def fitting_mask(view: View, path: Path) -> FileMask:
    """The mask in a file, scaled to the view's photograph where it is smaller or larger.

    Raises
    ------
    DataError : unreadable, or of another shape than the photograph.
    """
    width, height = (file := ImageFile(path)).size
    if not same_shape((width, height), (view.width, view.height)):
        turned = (width < height) != (view.width < view.height)
        raise DataError(
            f"{file.path}: expected {view.width}x{view.height} pixels like view {view.name}, or the same shape, "
            f"got {width}x{height}{'; photographs are set upright as their EXIF says' if turned else ''}"
        )
    return FileMask(file, of_size=(view.width, view.height))


def fitting_masks(views: Sequence[View], files: Mapping[str, Path]) -> dict[str, FileMask]:
    """Masks of the views that have a file, scaled to their photographs.

    Where most are white along the image's border and black in its middle, black is taken for object, with a warning.

    Raises
    ------
    DataError : a file is unreadable, or of another shape than the photograph.
    """
    masked = [view for view in views if view.name in files]
    masks = {view.name: fitting_mask(view, files[view.name]) for view in masked}
    chosen = np.unique(np.linspace(0, len(masked) - 1, min(_LOOKED_AT, len(masked))).round().astype(int))
    shares = np.array([_rim_and_middle(masked[n], masks[masked[n].name]) for n in chosen])
    if not len(shares) or not ((shares[:, 0] >= _RIM_SHARE) & (shares[:, 1] <= _MIDDLE_SHARE)).mean() > 0.5:
        return masks
    folder = masks[masked[0].name].file.path.parent
    warnings.warn(
        f"{folder}: its masks are white all around and black in the middle: black is taken for object, not white",
        stacklevel=4,
    )
    return {name: replace(mask, inverted=True) for name, mask in masks.items()}


def _rim_and_middle(view: View, mask: FileMask) -> tuple[float, float]:
    """Shares of the pixels that are object, at the image's border and in its middle."""
    held = replace(mask, of_size=None).read(replace(view.calibration, distortion=()))
    height, width = held.shape
    rim = np.concatenate([held[0], held[-1], held[:, 0], held[:, -1]])
    middle = held[2 * height // 5 : 3 * height // 5 + 1, 2 * width // 5 : 3 * width // 5 + 1]
    return float(rim.mean()), float(middle.mean())
