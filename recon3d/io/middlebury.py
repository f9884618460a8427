"""Middlebury multi-view sets: ``*_par.txt``, photographs and a README that holds the bounding box.

The files' conventions are recon3d's own: P = K [R | t], x right, y down, pixel centres at integers; the world is in
metres, and every set has its own world frame. A README that recon3d writes beside a scene of any format says the unit.
"""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np

from recon3d.errors import DataError
from recon3d.io.calibrated import Calibrated, CalibratedImage
from recon3d.io.files import write_image, write_text
from recon3d.io.par_file import camera_of_line, plain_name, poses_of_lines, read_par_file
from recon3d.io.parsing import number_fields, read_text
from recon3d.io.photographs import IMAGE_FOLDERS, find_image, find_images
from recon3d.scene.bounds import Bounds
from recon3d.scene.mask_files import mask_folders
from recon3d.scene.names import file_stems
from recon3d.scene.photograph import Photograph
from recon3d.scene.scene import Scene

PADDING = 0.01
"""Fraction of the longest side added around a README's box, which is tight to about a millimetre."""

SILHOUETTE_FOLDER = "silhouettes"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_UNIT, _NO_UNIT = "A world unit is", "not known"  # of a README that recon3d has written
_CORNER = r"[(\[{]([^()\[\]{}]+)[)\]}]"


def is_middlebury(path: Path) -> bool:
    """Whether this is a ``*_par.txt``, or a folder that holds one."""
    return bool(_files(path, "par") if path.is_dir() else re.fullmatch(_named("par"), path.name, re.IGNORECASE))


def read_middlebury(path: Path, images: Path | None = None) -> Calibrated:
    """Cameras, photographs, box and masks of a Middlebury multi-view set.

    Parameters
    ----------
    path : the set's folder, or its par file.
    images : folder of the photographs, where they do not lie with the par file.

    Raises
    ------
    DataError : a file is missing or malformed; names file and line.
    """
    file = _par_file(path)
    folder = file.parent
    box, no_box = None, ""
    try:
        box = read_padded_bounds(folder)
    except DataError as error:
        no_box = str(error)
    lines = read_par_file(file)
    found, told = _photographs([line.name for line in lines], file, images)
    poses, left_handed = poses_of_lines(lines)
    views: dict[Path, CalibratedImage] = {}
    for line in lines:
        if line.name not in found:
            continue
        photograph = Photograph(found[line.name])
        camera = camera_of_line(line, poses[line.where], photograph.size)
        if found[line.name] in views:
            raise DataError(f"{line.where}: {line.name} is the photograph of a line before")
        first = next(iter(views.values()), None)
        same_size = first and (camera.width, camera.height) == (first.camera.width, first.camera.height)
        if first and not same_size and (camera.K == first.camera.K).all():
            raise DataError(
                f"{line.where}: expected {line.name} to have {first.camera.width}x{first.camera.height} pixels like "
                f"{first.name}, whose K is the same, got {camera.width}x{camera.height}"
            )
        views[found[line.name]] = CalibratedImage(line.name, photograph, camera)
    return Calibrated(
        folder.resolve().name,
        tuple(views.values()),
        bounds=box,
        no_bounds=no_box,
        left_handed=left_handed,
        mm_per_unit=None if f"{_UNIT} {_NO_UNIT}" in _text_of_readme(folder) else 1000.0,
        masked=_good_silhouettes(folder, {line.name for line in lines}),
        notes={"format": "Middlebury", **told},
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
    unit = _NO_UNIT if scene.mm_per_unit is None else f"{scene.mm_per_unit!r} mm"
    return write_text(
        folder / "README.txt",
        f"{scene.name}: {len(scene.views)} views\n\nThe (tight) bounding box is\n({low})\n({high})\n\n"
        f"{_UNIT} {unit}.\n",
    )


def read_unit(folder: Path) -> float | None:
    """Millimetres in a world unit, where the README of a scene that recon3d wrote says them."""
    found = re.search(rf"{_UNIT} ({_NUMBER}) mm\b", _text_of_readme(folder))
    return float(found[1]) if found and 0 < float(found[1]) < np.inf else None


def read_bounds(folder: Path | str) -> Bounds:
    """The bounding box as the README of a set gives it, not padded.

    Raises
    ------
    DataError : there is no README, or no box in it.
    """
    readme = _readme(folder)
    text = read_text(readme)
    in_brackets = re.findall(rf"{_CORNER}\W{{0,3}}{_CORNER}", text)
    for pair in (*in_brackets, *product(_lines_of(text, "min"), _lines_of(text, "max"))):
        corners = [_numbers(corner) for corner in pair]
        if all(len(corner) == 3 for corner in corners):
            return Bounds(*corners)
    raise DataError(f"{readme}: expected a bounding box '(x y z) (x y z)'; give bounds instead")


def _lines_of(text: str, word: str) -> list[str]:
    """What follows a word that begins so, up to the line's end."""
    return re.findall(rf"^\W*{word}\w*[^\w\n.+-]*([-+.\d].*)$", text, re.IGNORECASE | re.MULTILINE)


def _numbers(text: str) -> list[float]:
    """Finite numbers of a text; none where anything else is in it."""
    try:
        return [number for field in number_fields(text, (3,)) if np.isfinite(number := float(field))]
    except ValueError:
        return []


def read_padded_bounds(folder: Path | str) -> Bounds:
    """The same with a margin."""
    tight = read_bounds(folder)
    return tight.padded(PADDING * tight.longest)


def read_angles(folder: Path | str) -> dict[str, tuple[float, float]]:
    """Latitude and longitude in degrees of each view, from ``*_ang.txt``; empty where there is no such file."""
    files = _files(Path(folder), "ang")
    angles = {}
    for number, line in enumerate(read_text(files[0]).splitlines() if files else [], start=1):
        fields = line.split(maxsplit=2)
        if not fields:
            continue
        try:
            latitude, longitude, name = float(fields[0]), float(fields[1]), plain_name(fields[2])
        except (ValueError, IndexError):
            raise DataError(f"{files[0]}:{number}: expected 'latitude longitude image', got {line.strip()!r}") from None
        angles[name] = latitude, longitude
    return angles


def _readme(folder: Path | str) -> Path:
    readmes = sorted(path for path in Path(folder).iterdir() if re.fullmatch(r"readme(\.\w+)?", path.name.lower()))
    if not readmes:
        raise DataError(f"{folder}: expected a README.txt with the bounding box; give bounds instead")
    return readmes[0]


def _text_of_readme(folder: Path) -> str:
    """Text of the README of a set; empty where there is none."""
    try:
        return read_text(_readme(folder))
    except DataError:
        return ""


def _named(kind: str) -> str:
    """Pattern of the name of a set's file: ``*_par.txt`` or ``par.txt``, but not what macOS leaves beside files."""
    return rf"(?!\.)(.*_)?{kind}\.txt"


def _files(folder: Path, kind: str) -> list[Path]:
    """A set's files of a kind, in upper case or lower."""
    return sorted(path for path in folder.iterdir() if re.fullmatch(_named(kind), path.name, re.IGNORECASE))


def _par_file(path: Path) -> Path:
    if path.is_file():
        return path
    found = _files(path, "par")
    if len(found) != 1:
        names = ", ".join(file.name for file in found)
        raise DataError(f"{path}: expected one file *_par.txt, found {len(found)}: {names}; give one of them instead")
    return found[0]


def _photographs(names: list[str], file: Path, images: Path | None) -> tuple[dict[str, Path], dict[str, str]]:
    """Photographs by name, and a note of their folder where it is not the par file's or one in it.

    They may lie in a folder beside, if that is the only one that holds them and no other set's.
    """
    folder = file.parent
    if images is not None:
        return find_images(names, [images], str(file)), {"photographs": str(images)}
    places = [folder, *(folder / name for name in IMAGE_FOLDERS if name), *_subfolders(folder)]
    if not any(find_image(place, name) for place in places for name in names):
        beside = [place for place in _subfolders(folder.absolute().parent) if not _files(place, "par")]
        holding = [place for place in beside if all(find_image(place, name) for name in names)]
        if len(holding) > 1:
            raise DataError(
                f"{file}: photographs of these names are in {', '.join(map(str, holding))}: say in which they are "
                "(--images DIR, images=...)"
            )
        if holding:
            return find_images(names, holding, str(file)), {"photographs": str(holding[0])}
        places += beside
    return find_images(names, places, str(file)), {}


def _subfolders(folder: Path) -> list[Path]:
    """Folders in a folder, but not of masks and not hidden ones."""
    masks = mask_folders([folder])
    return [path for path in sorted(folder.iterdir()) if path.is_dir() and path.name[0] != "." and path not in masks]


def _good_silhouettes(folder: Path, names: set[str]) -> frozenset[str] | None:
    """Names in ``*_good_silhouette_images.txt``, or None without that file."""
    files = _files(folder, "good_silhouette_images")
    if not files:
        return None
    known = {name.casefold(): name for name in names}
    good = set()
    for number, line in enumerate(read_text(files[0]).splitlines(), start=1):
        name = plain_name(line)
        if name and name.casefold() not in known:
            raise DataError(f"{files[0]}:{number}: {name} is not in the par file")
        if name:
            good.add(known[name.casefold()])
    return frozenset(good)
