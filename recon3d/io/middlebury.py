"""Middlebury multi-view sets: ``*_par.txt``, photographs and a README that holds the bounding box.

The files' conventions are recon3d's own: P = K [R | t], x right, y down, pixel centres at integers; the world is in
metres, and every set has its own world frame. A README that recon3d writes beside a scene of any format says the unit.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.files import write_image, write_text
from recon3d.io.handedness import right_handed
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.names import file_stems
from recon3d.scene.photograph import Photograph
from recon3d.scene.scene import Scene

PADDING = 0.01
"""Fraction of the longest side added around a README's box, which is tight to about a millimetre."""

SILHOUETTE_FOLDER = "silhouettes"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_CORNER = rf"\(\s*({_NUMBER})[\s,]+({_NUMBER})[\s,]+({_NUMBER})\s*\)"


def is_middlebury(folder: Path) -> bool:
    """Whether a folder holds a ``*_par.txt``."""
    return folder.is_dir() and any(folder.glob("*_par.txt"))


def read_middlebury(folder: Path) -> Calibrated:
    """Cameras, photographs, box and masks of a Middlebury multi-view set.

    Raises
    ------
    DataError : a file is missing or malformed; names file and line.
    """
    images, left_handed = _read_images(_only_file(folder, "*_par.txt"))
    box, no_box = None, ""
    try:
        box = read_padded_bounds(folder)
    except DataError as error:
        no_box = str(error)
    return Calibrated(
        folder.resolve().name,
        images,
        bounds=box,
        no_bounds=no_box,
        left_handed=left_handed,
        masked=_good_silhouettes(folder, {image.name for image in images}),
        notes={"format": "Middlebury"},
    )


def write_middlebury(scene: Scene, folder: Path | str) -> Path:
    """Write a scene as a Middlebury set, with its silhouettes beside it; returns the folder."""
    folder = Path(folder)
    names = [f"{stem}.png" for stem in file_stems(scene).values()]
    lines = [str(len(scene.views))]
    for view, name in zip(scene.views, names, strict=True):
        numbers = [*view.K.ravel(), *view.cam_from_world[:3, :3].ravel(), *view.cam_from_world[:3, 3]]
        lines.append(" ".join([name, *(repr(float(number)) for number in numbers)]))
        write_image(folder / name, view.image)
        silhouette = view.silhouette
        if silhouette is not None:
            write_image(folder / SILHOUETTE_FOLDER / name, silhouette)
    write_readme(scene, folder)
    write_text(folder / f"{scene.name}_par.txt", "\n".join(lines) + "\n")
    good = [name for view, name in zip(scene.views, names, strict=True) if view.has_silhouette]
    if 0 < len(good) < len(names):
        write_text(folder / f"{scene.name}_good_silhouette_images.txt", "\n".join(good) + "\n")
    return folder


def write_readme(scene: Scene, folder: Path) -> Path:
    """Write bounds and unit of a scene as the README of a set; returns the file."""
    tight = scene.bounds.padded(-PADDING / (1 + 2 * PADDING) * scene.bounds.longest)
    low, high = (" ".join(map(repr, corner)) for corner in (tight.low, tight.high))
    unit = "not known" if scene.mm_per_unit is None else f"{scene.mm_per_unit!r} mm"
    return write_text(
        folder / "README.txt",
        f"{scene.name}: {len(scene.views)} views\n\nThe (tight) bounding box is\n({low})\n({high})\n\n"
        f"A world unit is {unit}.\n",
    )


def read_unit(folder: Path) -> float | None:
    """Millimetres in a world unit, where the README of a scene that recon3d wrote says them."""
    try:
        found = re.search(rf"A world unit is ({_NUMBER}) mm\b", _readme(folder).read_text(errors="replace"))
    except DataError:
        return None
    return float(found[1]) if found and 0 < float(found[1]) < np.inf else None


def read_bounds(folder: Path | str) -> Bounds:
    """The bounding box as the README of a set gives it, not padded.

    Raises
    ------
    DataError : there is no README, or no box in it.
    """
    readme = _readme(folder)
    found = re.search(rf"{_CORNER}\s*{_CORNER}", readme.read_text(errors="replace"))
    if not found:
        raise DataError(f"{readme}: expected a bounding box '(x y z) (x y z)'; give bounds instead")
    numbers = [float(number) for number in found.groups()]
    return Bounds(numbers[:3], numbers[3:])


def read_padded_bounds(folder: Path | str) -> Bounds:
    """The same with a margin."""
    tight = read_bounds(folder)
    return tight.padded(PADDING * tight.longest)


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


def _readme(folder: Path | str) -> Path:
    readmes = sorted(path for path in Path(folder).iterdir() if path.name.lower() in ("readme.txt", "readme"))
    if not readmes:
        raise DataError(f"{folder}: expected a README.txt with the bounding box; give bounds instead")
    return readmes[0]


def _only_file(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern)) if folder.is_dir() else []
    if len(found) != 1:
        raise DataError(f"{folder}: expected one file {pattern}, found {len(found)}")
    return found[0]


def _lines(file: Path) -> list[str]:
    """Lines of a text file; bytes that are no UTF-8 are left to be found wrong where they stand."""
    return file.read_text(encoding="utf-8", errors="replace").splitlines()


def _read_images(par_file: Path) -> tuple[tuple[CalibratedImage, ...], bool]:
    """Images of a par file, with or without its count line, and whether its world is left-handed."""
    lines = [(n, line.split()) for n, line in enumerate(_lines(par_file), start=1) if line.strip()]
    expected = None
    if lines and len(lines[0][1]) == 1 and lines[0][1][0].isdigit():
        expected = int(lines.pop(0)[1][0])
    if expected is not None and expected != len(lines):
        raise DataError(f"{par_file}:1: the count line says {expected} views, the file has {len(lines)}")
    if not lines:
        raise DataError(f"{par_file}: expected at least one view")
    matrices = {}
    for number, fields in lines:
        where = f"{par_file}:{number}"
        if len(fields) != 22:
            raise DataError(f"{where}: expected an image name and 21 numbers, got {len(fields)} fields")
        name, path = fields[0], par_file.parent / fields[0]
        if not path.is_file():
            raise DataError(f"{where}: image {path} is missing")
        matrices[where] = _matrices(fields[1:], where)
    poses, left_handed = right_handed({where: pose for where, (_, pose) in matrices.items()})
    images: list[CalibratedImage] = []
    for (where, (K, _)), (_, fields) in zip(matrices.items(), lines, strict=True):
        name, photograph = fields[0], Photograph(par_file.parent / fields[0])
        try:
            camera = Camera(K, poses[where], *photograph.size)
        except ValueError as error:
            raise DataError(f"{where}: {error}") from None
        first = images[0] if images else None
        if first and (camera.width, camera.height) != (first.camera.width, first.camera.height):
            raise DataError(
                f"{where}: expected {name} to have {first.camera.width}x{first.camera.height} pixels like "
                f"{first.name}, got {camera.width}x{camera.height}"
            )
        images.append(CalibratedImage(name, photograph, camera))
    return tuple(images), left_handed


def _matrices(fields: list[str], where: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, 3) K and (3, 4) [R | t] of 21 fields."""
    numbers = []
    for field in fields:
        try:
            numbers.append(float(field))
        except ValueError:
            raise DataError(f"{where}: expected a number, got {field!r}") from None
    K, R, t = np.split(np.array(numbers), [9, 18])
    return K.reshape(3, 3), np.column_stack([R.reshape(3, 3), t])


def _good_silhouettes(folder: Path, names: set[str]) -> frozenset[str] | None:
    """Names in ``*_good_silhouette_images.txt``, or None without that file."""
    files = sorted(folder.glob("*_good_silhouette_images.txt"))
    if not files:
        return None
    good = set()
    for number, line in enumerate(_lines(files[0]), start=1):
        name = line.strip()
        if name and name not in names:
            raise DataError(f"{files[0]}:{number}: {name} is not in the par file")
        if name:
            good.add(name)
    return frozenset(good)
