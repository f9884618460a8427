"""The photographs that a scene's files mean, found as people name them, and their cameras."""

from __future__ import annotations

import os
import posixpath
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import CalibratedImage
from recon3d.scene.camera import Camera, same_shape
from recon3d.scene.mask_files import IMAGE_SUFFIXES, names_a_mask
from recon3d.scene.photograph import Photograph

IMAGE_FOLDERS = ("images", "image", "input", "rgb", "color", "photos", "")
"""Usual names of the folder of photographs, beside or in the folder of a model."""


def pinhole(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> NDArray[np.float64]:
    """(3, 3) K."""
    return np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])


def pinhole_from_corner(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> NDArray[np.float64]:
    """(3, 3) K of a format that counts pixels from the image's corner, the upper left pixel's centre being (½, ½)."""
    return pinhole(fx, fy, cx - 0.5, cy - 0.5, skew)


def camera_of(
    K: ArrayLike,
    cam_from_world: ArrayLike,
    calibrated_size: tuple[int, int] | None,
    photograph: Photograph,
    where: str,
    distortion: ArrayLike = (),
) -> Camera:
    """The camera of a photograph, scaled where that is a smaller or larger copy of the one that was calibrated.

    Parameters
    ----------
    K : (3, 3), pixels.
    cam_from_world : (3, 4) or (4, 4), world to camera.
    calibrated_size : width and height that K is of; the photograph's when None.
    where : what an error names: the file, and the place in it.
    distortion : (n,) OpenCV's coefficients.

    Raises
    ------
    DataError : K, the pose, or the photograph's shape is wrong.
    """
    size = photograph.size
    expected = calibrated_size or size
    try:
        camera = Camera(K, cam_from_world, *expected, distortion)
    except ValueError as error:
        raise DataError(f"{where}: {error}") from None
    if expected == size:
        return camera
    if not same_shape(size, expected):
        raise DataError(
            f"{where}: expected a photograph of {expected[0]}x{expected[1]} pixels, as was calibrated, or a scaled "
            f"copy of it, got {size[0]}x{size[1]}"
        )
    return camera.scaled(*size)


def photograph_of(path: Path, size: tuple[int, int] | None, *, stored: bool) -> Photograph:
    """A photograph, upright or as it is stored, whichever has the calibrated shape.

    Parameters
    ----------
    stored : whether the format's pixels are those of the file as it is stored, where the shape does not tell.
    """
    ways = [Photograph(path, stored_orientation=as_stored) for as_stored in (stored, not stored)]
    if size is None:
        return ways[0]
    wide = size[0] > size[1]
    fitting = [way for way in ways if way.size == size] or [way for way in ways if (way.size[0] > way.size[1]) == wide]
    return fitting[0] if fitting else ways[0]


def image_files(folder: Path) -> list[Path]:
    """Photographs in a folder, in the order of the numbers in their names."""
    if not folder.is_dir():
        return []
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file() and not names_a_mask(path) and path.name[0] != "."
    ]
    return sorted(files, key=lambda path: natural(path.name))


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts 2 before 10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def find_image(folder: Path, name: str) -> Path | None:
    r"""A photograph by a name as people write it.

    That is with \ for /, without its ending, in another case, or by a path on the computer that calibrated it. It lies
    in the folder or below, whatever its name says: a scene is data, and may be a stranger's.
    """
    plain = posixpath.normpath(re.sub(r"\\+", "/", name.strip()))
    if plain.startswith(("/", "../")) or re.match(r"[A-Za-z]:/", plain):
        parts = [part for part in plain.split("/")[1:] if part != ".."]
        tails = ("/".join(parts[n:]) for n in range(len(parts)))
        return next((there for tail in tails if tail and (there := find_image(folder, tail))), None)
    path = folder / plain
    try:
        if path.is_file():
            return path
    except (OSError, ValueError):  # no name that a file can have
        return None
    near = _listing(path.parent)
    names = [entry.name.casefold() for entry in near]
    stems = [entry.stem.casefold() for entry in near]
    for asked_for, held in ((path.name, names), (path.name, stems), (path.stem, stems)):
        found = [entry for entry, name in zip(near, held, strict=True) if name == asked_for.casefold()]
        if found:
            return found[0] if len(found) == 1 else None
    return None


@lru_cache(maxsize=256)
def _listing_at(folder: Path, _changed: int) -> tuple[Path, ...]:
    return tuple(path for path in sorted(folder.iterdir()) if path.suffix.lower() in IMAGE_SUFFIXES)


def _listing(folder: Path) -> tuple[Path, ...]:
    """Image files of a folder."""
    return _listing_at(folder, folder.stat().st_mtime_ns) if folder.is_dir() else ()


def find_images(names: Sequence[str], folders: Iterable[Path], where: str) -> dict[str, Path]:
    """Photographs by name, in the folder that has most of them; those that are missing are warned of.

    Raises
    ------
    DataError : none is in any of the folders.
    """
    places = list(dict.fromkeys(folder for folder in folders if folder.is_dir()))
    best: dict[str, Path] = {}
    for place in places:
        found = {name: path for name in names if (path := find_image(place, name))}
        if len(found) > len(best):
            best = found
        if len(best) == len(names):
            break
    missing = [name for name in names if name not in best]
    if not best:
        raise DataError(
            f"{where}: none of its {len(names)} photographs is there: looked for {names[0] if names else '-'} in "
            f"{listed([str(place) for place in places]) or 'no folder'}; if they are elsewhere name their folder "
            "(--images DIR, images=...)"
        )
    warn_of_missing(missing, where)
    return best


def warn_of_missing(missing: Sequence[str], where: str) -> None:
    """Name photographs that are listed and not there."""
    if missing:
        warnings.warn(f"{where}: left out, their photographs are missing: {listed(missing)}", stacklevel=5)


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names for a message, not too many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def views_named(images: Mapping[Path, CalibratedImage]) -> tuple[CalibratedImage, ...]:
    """Images that are named by their paths below the folder that they share."""
    paths = [Path(os.path.normpath(path.absolute())) for path in images]
    top = Path(os.path.commonpath([path.parent for path in paths]))
    return tuple(
        image._replace(name=path.relative_to(top).as_posix())
        for path, image in zip(paths, images.values(), strict=True)
    )


def numbered(keys: Sequence[int], files: Sequence[Path], where: str) -> dict[int, Path]:
    """Photographs of numbered cameras: by the number at the end of their names, else by their order.

    Raises
    ------
    DataError : neither goes.
    """
    ends = [re.search(r"(\d+)\D*$", path.stem) for path in files]
    by_number = {int(end[1]): path for end, path in zip(ends, files, strict=True) if end}
    shared = set(by_number) & set(keys)
    if len(by_number) == len(files) and shared and shared in (set(by_number), set(keys)):
        warn_of_missing([str(key) for key in keys if key not in by_number], where)
        return {key: by_number[key] for key in keys if key in by_number}
    return dict(zip(keys, in_order(len(keys), files, where), strict=True))


def in_order(n: int, files: Sequence[Path], where: str) -> Sequence[Path]:
    """Photographs of n cameras, in the order of the numbers in their names.

    Raises
    ------
    DataError : their numbers differ.
    """
    if len(files) != n:
        place = files[0].parent if files else "any folder beside it"
        raise DataError(
            f"{where}: expected a photograph for each of {n} cameras, in the order of their names, found {len(files)} "
            f"in {place}"
        )
    return files
