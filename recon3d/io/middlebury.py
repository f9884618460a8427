"""Middlebury multi-view sets: ``*_par.txt``, photographs and a README that holds the bounding box.

The files' conventions are recon3d's own: P = K [R | t], x right, y down, pixel centres at integers; the world is in
metres, and every set has its own world frame.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError, SceneError
from recon3d.io.files import write_image, write_text
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import check_extrinsics, check_intrinsics
from recon3d.scene.photograph import read_image
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import (
    bounds_mask,
    foreground,
    with_mask_files,
    with_segmented_silhouettes,
    with_threshold_silhouettes,
)
from recon3d.scene.view import View

PADDING = 0.01
"""Fraction of the longest side added around a README's box, which is tight to about a millimetre."""

SILHOUETTE_FOLDER = "silhouettes"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_CORNER = rf"\(\s*({_NUMBER})[\s,]+({_NUMBER})[\s,]+({_NUMBER})\s*\)"


def is_middlebury(folder: Path) -> bool:
    """Whether a folder holds a ``*_par.txt``."""
    return folder.is_dir() and any(folder.glob("*_par.txt"))


def read_middlebury(
    folder: Path | str,
    *,
    bounds: Bounds | None = None,
    silhouettes: str | Path = "auto",
    mm_per_unit: float = 1000.0,
) -> Scene:
    """Read a Middlebury multi-view set.

    Parameters
    ----------
    bounds : the object's box in this set's own world frame; the README's, padded, when None.
    silhouettes : "auto": the folder ``silhouettes`` where there is one, else "segmented"; "segmented" or "threshold":
        made from the dark background, by GrabCut or by the recipe of dinoSparseRing's README, of the views that
        ``*_good_silhouette_images.txt`` lists or of all; "none"; or a folder of masks.
    mm_per_unit : 1000 for Middlebury's own sets, which are in metres.

    Raises
    ------
    DataError : a file is missing or malformed; names file and line.
    SceneError : the box does not fit the cameras or cuts the object off.
    """
    folder = Path(folder)
    par_file = _only_file(folder, "*_par.txt")
    views = _read_views(par_file)
    given = bounds is not None
    if bounds is None:
        bounds = read_bounds(folder)
        bounds = bounds.padded(PADDING * bounds.longest)
    scene = Scene(tuple(views), bounds, folder.resolve().name, mm_per_unit, {"format": "Middlebury"})
    _check_box(scene)
    own_masks = folder / SILHOUETTE_FOLDER
    if silhouettes == "none":
        return scene
    if silhouettes == "auto" and own_masks.is_dir():
        return with_mask_files(scene, own_masks, only=_good_silhouettes(folder, scene))
    if silhouettes in ("auto", "segmented", "threshold"):
        _check_foreground(scene, must_fit=not given)
    if silhouettes == "threshold":
        return with_threshold_silhouettes(scene, only=_good_silhouettes(folder, scene))
    if silhouettes in ("auto", "segmented"):
        return with_segmented_silhouettes(scene, only=_good_silhouettes(folder, scene))
    return with_mask_files(scene, silhouettes)


def write_middlebury(scene: Scene, folder: Path | str) -> Path:
    """Write a scene as a Middlebury set, with its silhouettes beside it; returns the folder."""
    folder = Path(folder)
    names = ["_".join(Path(view.name).stem.split()) + ".png" for view in scene.views]
    if len(set(names)) < len(names):
        raise ValueError(f"scene {scene.name}: two views would be written to one file: {', '.join(names)}")
    lines = [str(len(scene.views))]
    for view, name in zip(scene.views, names, strict=True):
        numbers = [*view.K.ravel(), *view.cam_from_world[:3, :3].ravel(), *view.cam_from_world[:3, 3]]
        lines.append(" ".join([name, *(repr(float(number)) for number in numbers)]))
        write_image(folder / name, view.image)
        if view.silhouette is not None:
            write_image(folder / SILHOUETTE_FOLDER / name, view.silhouette)
    tight = scene.bounds.padded(-PADDING / (1 + 2 * PADDING) * scene.bounds.longest)
    low, high = (" ".join(map(repr, corner)) for corner in (tight.low, tight.high))
    write_text(
        folder / "README.txt",
        f"{scene.name}: {len(scene.views)} views\n\nThe (tight) bounding box is\n({low})\n({high})\n",
    )
    write_text(folder / f"{scene.name}_par.txt", "\n".join(lines) + "\n")
    good = [name for view, name in zip(scene.views, names, strict=True) if view.silhouette is not None]
    if 0 < len(good) < len(names):
        write_text(folder / f"{scene.name}_good_silhouette_images.txt", "\n".join(good) + "\n")
    return folder


def read_bounds(folder: Path | str) -> Bounds:
    """The bounding box as the README of a set gives it, not padded.

    Raises
    ------
    DataError : there is no README, or no box in it.
    """
    folder = Path(folder)
    readmes = sorted(path for path in folder.iterdir() if path.name.lower() in ("readme.txt", "readme"))
    if not readmes:
        raise DataError(f"{folder}: expected a README.txt with the bounding box; give bounds instead")
    found = re.search(rf"{_CORNER}\s*{_CORNER}", readmes[0].read_text(errors="replace"))
    if not found:
        raise DataError(f"{readmes[0]}: expected a bounding box '(x y z) (x y z)'; give bounds instead")
    numbers = [float(number) for number in found.groups()]
    return Bounds(numbers[:3], numbers[3:])


def read_angles(folder: Path | str) -> dict[str, tuple[float, float]]:
    """Latitude and longitude in degrees of each view, from ``*_ang.txt``; empty where there is no such file."""
    files = sorted(Path(folder).glob("*_ang.txt"))
    angles = {}
    for number, line in enumerate(_lines(files[0]) if files else [], start=1):
        fields = line.split()
        if not fields:
            continue
        try:
            latitude, longitude, name = float(fields[0]), float(fields[1]), fields[2]
        except (ValueError, IndexError):
            raise DataError(f"{files[0]}:{number}: expected 'latitude longitude image', got {line.strip()!r}") from None
        angles[name] = latitude, longitude
    return angles


def _only_file(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern)) if folder.is_dir() else []
    if len(found) != 1:
        raise DataError(f"{folder}: expected one file {pattern}, found {len(found)}")
    return found[0]


def _lines(file: Path) -> list[str]:
    """Lines of a text file; bytes that are no UTF-8 are left to be found wrong where they stand."""
    return file.read_text(encoding="utf-8", errors="replace").splitlines()


def _read_views(par_file: Path) -> list[View]:
    """Views of a par file, with or without its count line."""
    lines = [(n, line.split()) for n, line in enumerate(_lines(par_file), start=1) if line.strip()]
    expected = None
    if lines and len(lines[0][1]) == 1 and lines[0][1][0].isdigit():
        expected = int(lines.pop(0)[1][0])
    if expected is not None and expected != len(lines):
        raise DataError(f"{par_file}:1: the count line says {expected} views, the file has {len(lines)}")
    if not lines:
        raise DataError(f"{par_file}: expected at least one view")
    views: list[View] = []
    for number, fields in lines:
        where = f"{par_file}:{number}"
        if len(fields) != 22:
            raise DataError(f"{where}: expected an image name and 21 numbers, got {len(fields)} fields")
        K, cam_from_world = _matrices(fields[1:], where)
        image_path = par_file.parent / fields[0]
        if not image_path.is_file():
            raise DataError(f"{where}: image {image_path} is missing")
        image = read_image(image_path)
        if views and image.shape != views[0].image.shape:
            raise DataError(
                f"{where}: expected {fields[0]} to have {views[0].width}x{views[0].height} pixels like "
                f"{views[0].name}, got {image.shape[1]}x{image.shape[0]}"
            )
        views.append(View.from_matrices(K, cam_from_world, image, name=fields[0]))
    return views


def _matrices(fields: list[str], where: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K (3, 3) and [R | t] as (4, 4) from 21 fields."""
    numbers = []
    for field in fields:
        try:
            numbers.append(float(field))
        except ValueError:
            raise DataError(f"{where}: expected a number, got {field!r}") from None
    K = np.array(numbers[:9]).reshape(3, 3)
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = np.array(numbers[9:18]).reshape(3, 3)
    cam_from_world[:3, 3] = numbers[18:]
    problem = check_intrinsics(K) or check_extrinsics(cam_from_world)
    if problem:
        raise DataError(f"{where}: {problem}")
    return K, cam_from_world


def _good_silhouettes(folder: Path, scene: Scene) -> set[str] | None:
    """Names in ``*_good_silhouette_images.txt``, or None without that file."""
    files = sorted(folder.glob("*_good_silhouette_images.txt"))
    if not files:
        return None
    names = {view.name for view in scene.views}
    good = set()
    for number, line in enumerate(_lines(files[0]), start=1):
        name = line.strip()
        if name and name not in names:
            raise DataError(f"{files[0]}:{number}: {name} is not in the par file")
        if name:
            good.add(name)
    return good


def _check_box(scene: Scene) -> None:
    """Refuse a box that leaves the images, as another set's frame would have it."""
    corners = scene.bounds.corners
    seen = [int(view.sees(corners).sum()) for view in scene.views]
    if np.median(seen) < 4:
        worst = int(np.argmin(seen))
        raise SceneError(
            f"{scene.name}: expected at least 4 of the bounding box's 8 corners inside most images, got a median of "
            f"{np.median(seen):g} ({scene.views[worst].name}: {seen[worst]}). Every set has its own world frame: is "
            "this another set's box?"
        )


def _check_foreground(scene: Scene, *, must_fit: bool) -> None:
    """Refuse a box that cuts a bright object on a dark background off, or warn of it."""
    shares = []
    for view in scene.views:
        bright = foreground(view.image)
        held, all_bright = (int(np.count_nonzero(mask)) for mask in (bright & bounds_mask(scene, view), bright))
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
