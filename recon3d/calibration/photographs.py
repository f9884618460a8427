"""Photographs as they come from a camera: upright, with what their EXIF tells of the lens."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image

from recon3d.calibration.colmap import load_pycolmap
from recon3d.errors import DataError
from recon3d.scene.heic import HEIC_SUFFIXES, WAY_OUT, is_heic, reads_heic
from recon3d.scene.image_file import ImageFile

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
"""And those of HEIC, where the package that reads it is installed."""

_NOT_READ = (".avif", ".webp", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
_DIAGONAL_35MM = float(np.hypot(36.0, 24.0))
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # of EXIF's FocalPlaneResolutionUnit
_ASPECT_TOLERANCE = 0.02


@dataclass(frozen=True)
class PhotoFile:
    """One file, not yet decoded."""

    path: Path
    digest: str
    """Hash of the file's content and its mask's."""
    width: int
    """Pixels of the upright picture, EXIF's orientation applied."""
    height: int
    focal_length: float | None
    """Pixels, as EXIF has it; None: not told."""
    lens: str
    """Photographs of equal text share one camera: size, maker, model and focal length."""
    mask: Path | None = None
    """Picture of the same size, 0 where features are not wanted."""

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name


def find_photographs(
    source: Path | str | Iterable[Path | str], *, masks: Path | str | None = None
) -> tuple[PhotoFile, ...]:
    """Photographs of a folder, or those given, in the order of their names.

    Parameters
    ----------
    source : a folder, searched for JPEG, PNG, TIFF and HEIC files (folders in it are not), or files.
    masks : folder of masks, named as the photograph, with ``.png`` in place of its suffix or after it.

    Raises
    ------
    DataError : no such file or folder, nothing in it, two files of one name, or one that is not readable.
    """
    paths = _files(source)
    if not paths:
        told = "".join(f"; {name}: {reason}" for name, reason in list(unread(source).items())[:1])
        raise DataError(f"{source}: expected photographs ({', '.join(SUFFIXES)}), found none{told}")
    by_stem: dict[str, Path] = {}
    for path in paths:
        other = by_stem.setdefault(path.stem, path)
        if other is not path:
            raise DataError(f"{path} and {other} share the name {path.stem}: keep one of them, or rename it")
    return tuple(_photograph(path, masks) for path in paths)


def unread(source: Path | str | Iterable[Path | str]) -> dict[str, str]:
    """Names of a folder's photographs that are of a kind which is not read, with the way out."""
    if not isinstance(source, str | Path):
        return {}
    reasons = {}
    for path in sorted(Path(source).iterdir()):
        if path.name[0] != "." and path.suffix.lower() in _NOT_READ:
            reasons[path.name] = f"{path.suffix} is not read; convert it to JPEG with its EXIF kept"
        elif path.name[0] != "." and is_heic(path) and not reads_heic():
            reasons[path.name] = f"{path.suffix} is not read without a package of its own; {WAY_OUT}"
    return reasons


def _files(source: Path | str | Iterable[Path | str]) -> list[Path]:
    if isinstance(source, str | Path):
        folder = Path(source)
        if not folder.is_dir():
            raise DataError(f"{folder}: no such folder")
        known = {*SUFFIXES, *(HEIC_SUFFIXES if reads_heic() else ())}
        found = [path for path in folder.iterdir() if path.suffix.lower() in known and path.name[0] != "."]
    else:
        found = [Path(path) for path in source]
        for path in found:
            if not path.is_file():
                raise DataError(f"{path}: no such photograph")
            if is_heic(path) and not reads_heic():
                raise DataError(f"{path}: a HEIC photograph; {WAY_OUT}")
            if path.suffix.lower() not in SUFFIXES and not is_heic(path):
                raise DataError(f"{path}: expected a photograph of a kind among {', '.join(SUFFIXES)}; convert it")
    return sorted(found, key=lambda path: path.name)


def _photograph(path: Path, masks: Path | str | None) -> PhotoFile:
    mask = None if masks is None else _mask_file(path, Path(masks))
    digest = hashlib.sha256(path.read_bytes())
    if mask is not None:
        digest.update(mask.read_bytes())
    width, height = ImageFile(path).size
    tags, stored_size = _exif(path)
    focal_length = _focal_length(path, tags, *stored_size)
    parts = [width, height, "" if focal_length is None else f"{focal_length:.1f}"]
    parts += [str(tags.get(tag, "")).strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model)]
    return PhotoFile(path, digest.hexdigest()[:24], width, height, focal_length, " ".join(map(str, parts)), mask)


def _exif(path: Path) -> tuple[dict[int, object], tuple[int, int]]:
    """EXIF's tags by number, and the width and height of the picture as it is stored."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tags that other programs have damaged
        try:
            with Image.open(path) as image:
                exif = image.getexif()
                return {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}, image.size
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            raise DataError(f"{path}: not a readable image ({error})") from None


def _mask_file(path: Path, masks: Path) -> Path:
    for name in (path.name, f"{path.stem}.png", f"{path.name}.png"):
        if (masks / name).is_file():
            return masks / name
    raise DataError(f"{masks}: expected a mask {path.stem}.png for the photograph {path.name}")


def _focal_length(path: Path, tags: dict[int, object], width: int, height: int) -> float | None:
    """Focal length in pixels of the stored picture, which may be a smaller copy of what the camera took, or None."""
    taken = [_number(tags.get(tag)) for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)]
    known = all(side > 0 for side in taken)
    if known and abs(max(taken) / min(taken) / (max(width, height) / min(width, height)) - 1) > _ASPECT_TOLERANCE:
        return None  # cropped: the field of view is no longer that of the lens
    equivalent = _number(tags.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent > 0:
        return equivalent * float(np.hypot(width, height)) / _DIAGONAL_35MM
    focal_mm = _number(tags.get(ExifTags.Base.FocalLength))
    if focal_mm <= 0:
        return None
    per_unit = _number(tags.get(ExifTags.Base.FocalPlaneXResolution))
    unit_mm = _MM_PER_UNIT.get(int(_number(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))))
    if per_unit > 0 and unit_mm and known:
        return focal_mm * per_unit / unit_mm * max(width, height) / max(taken)
    if is_heic(path):
        return None
    camera = load_pycolmap().infer_camera_from_image(path)  # which knows the sensors of many cameras
    return float(camera.focal_length) if camera.has_prior_focal_length else None


def _number(value: object) -> float:
    """A tag as a finite number; 0 for anything else."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if np.isfinite(number) else 0.0


def duplicates(photographs: Sequence[PhotoFile]) -> dict[str, str]:
    """Names of photographs that repeat an earlier one's content, with that one's name."""
    first: dict[str, str] = {}
    return {
        photograph.name: first[photograph.digest]
        for photograph in photographs
        if first.setdefault(photograph.digest, photograph.name) != photograph.name
    }
