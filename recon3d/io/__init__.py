"""Scenes and geometry, in and out of files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from recon3d.errors import DataError
from recon3d.io.checkpoints import Checkpoints
from recon3d.io.geometry import read_geometry, read_mesh, read_support, write_geometry
from recon3d.io.middlebury import is_middlebury, read_angles, read_bounds, read_middlebury, write_middlebury
from recon3d.scene.scene import Scene


class Format(NamedTuple):
    """How a scene format is recognised and read."""

    recognises: Callable[[Path], bool]
    read: Callable[..., Scene]
    sign: str


FORMATS: dict[str, Format] = {
    "middlebury": Format(is_middlebury, read_middlebury, "a folder with a *_par.txt (Middlebury)"),
}

_WORDS = ("auto", "segmented", "threshold", "none")  # for silhouettes; anything else is a folder


def open_scene(path: Path | str, **options: Any) -> Scene:
    """Read a scene from a folder of calibrated photographs, whatever its format.

    Parameters
    ----------
    options : passed to the format's reader, such as ``bounds`` and ``silhouettes`` of ``read_middlebury``.

    Raises
    ------
    DataError : nothing there, of no known format, or malformed.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    for known in FORMATS.values():
        if known.recognises(path):
            scene = known.read(path, **options)
            masks = str(options.get("silhouettes", "auto"))
            masks = masks if masks in _WORDS or not Path(masks).is_dir() else str(Path(masks).resolve())
            return replace(scene, notes={**scene.notes, "source": str(path.resolve()), "silhouettes from": masks})
    raise DataError(f"{path}: not a known scene; expected {' or '.join(known.sign for known in FORMATS.values())}")


__all__ = [
    "FORMATS",
    "Checkpoints",
    "Format",
    "open_scene",
    "read_angles",
    "read_bounds",
    "read_geometry",
    "read_mesh",
    "read_middlebury",
    "read_support",
    "write_geometry",
    "write_middlebury",
]
