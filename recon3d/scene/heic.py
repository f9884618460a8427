"""HEIC photographs, as telephones take them, by a package that is installed on demand.

``pi-heif`` (BSD 3-clause) reads them through libheif and libde265, which its wheels bring along under the LGPL.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recon3d.errors import DataError

HEIC_SUFFIXES = frozenset({".heic", ".heif"})
"""In lower case."""

WAY_OUT = "pip install 'recon3d[heic]' reads it; or convert it to JPEG with its EXIF kept"
"""What to do where the package is missing."""


def is_heic(path: Path) -> bool:
    """Whether a file's name says that it is a HEIC photograph."""
    return path.suffix.lower() in HEIC_SUFFIXES


def reads_heic() -> bool:
    """Whether the package that reads them is installed."""
    return importlib.util.find_spec("pi_heif") is not None


def register_heic(path: Path) -> None:
    """Let Pillow read HEIC, already upright.

    Raises
    ------
    DataError : the package is missing; names the file, and says how to go on.
    """
    try:
        import pi_heif
    except ImportError:
        raise DataError(f"{path}: a HEIC photograph; {WAY_OUT}") from None
    pi_heif.register_heif_opener()


def decode_heic(path: Path) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of 8 bits, upright.

    Raises
    ------
    DataError : the package is missing, or the file is damaged.
    """
    register_heic(path)
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), np.uint8)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DataError(f"{path}: not a readable image ({error})") from None
