"""Image files: size and orientation from the header, pixels when they are asked for."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from recon3d.errors import DataError

_WITH_ALPHA = ("RGBA", "LA", "PA", "RGBa", "La")  # Pillow's modes
_ORIENTATION = 0x0112  # EXIF tag
_TURNS = {2: (0, True), 3: (2, False), 4: (2, True), 5: (3, True), 6: (3, False), 7: (1, True), 8: (1, False)}
"""EXIF orientation to the quarter turns to the left, and then the mirroring left to right, that set it upright."""


@dataclass(frozen=True)
class ImageFile:
    """An image file, upright: turned as its EXIF orientation says.

    Raises
    ------
    DataError : missing or unreadable, when size or pixels are asked for.
    """

    path: Path
    """Absolute."""
    stored_orientation: bool = False
    """Leave the rows and columns as they are stored, whatever the EXIF orientation says."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path).absolute())

    def __getstate__(self) -> dict[str, object]:
        return {"path": self.path, "stored_orientation": self.stored_orientation}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright picture; only the header is read."""
        width, height, orientation, _ = self._header
        return (height, width) if orientation >= 5 else (width, height)

    @property
    def has_alpha(self) -> bool:
        """Whether pixels have an opacity; only the header is read."""
        return self._header[3]

    @cached_property
    def _header(self) -> tuple[int, int, int, bool]:
        """Width and height as stored, the EXIF orientation to be undone, and whether there is an opacity."""
        if not self.path.is_file():
            raise DataError(f"{self.path}: no such image")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                with Image.open(self.path) as image:
                    # A PNG's EXIF is looked for before its pixels only; getexif would decode them.
                    known = image.format != "PNG" or "exif" in image.info
                    orientation = image.getexif().get(_ORIENTATION, 1) if known else 1
                    (width, height), kind = image.size, image.format
                    alpha = image.mode in _WITH_ALPHA or "transparency" in image.info
        except Image.DecompressionBombError:
            height, width = self._stored(cv2.IMREAD_GRAYSCALE).shape
            orientation, kind, alpha = 1, None, False
        except (UnidentifiedImageError, OSError, ValueError, SyntaxError):
            raise DataError(f"{self.path}: not a readable image") from None
        if kind == "TIFF" and orientation in _TURNS:  # OpenCV 5.0 fails on those
            raise DataError(f"{self.path}: a TIFF that is stored turned is not supported; save it upright")
        turned = orientation in _TURNS and not self.stored_orientation
        return width, height, orientation if turned else 1, alpha

    def version(self) -> tuple[str, bool, int, int]:
        """Key that changes when the file is written again."""
        try:
            found = self.path.stat()
        except OSError as error:
            raise DataError(f"{self.path}: no such image ({error.strerror})") from None
        return str(self.path), self.stored_orientation, found.st_mtime_ns, found.st_size

    def fingerprint(self) -> str:
        """Text that two files share only where their bytes and their orientation are the same."""
        return f"{_digest(*self.version())} {self.stored_orientation}"

    def decode(self, *, grey: bool = False) -> NDArray[np.uint8]:
        """Upright picture: (height, width, 3) RGB, or (height, width) grey."""
        width, height, _, _ = self._header
        image = self._stored(cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH if grey else cv2.IMREAD_COLOR_RGB)
        if image.shape[:2] != (height, width):
            raise DataError(
                f"{self.path}: the header says {width}x{height} pixels, {image.shape[1]}x{image.shape[0]} were read"
            )
        return self._upright(image)

    def decode_alpha(self) -> NDArray[np.uint8]:
        """Upright opacity (height, width), 0 to 255; 255 everywhere in a file without one."""
        try:
            with warnings.catch_warnings(), Image.open(self.path) as image:
                warnings.simplefilter("ignore")
                return self._upright(np.asarray(image.convert("RGBA").getchannel("A"), np.uint8))
        except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError):
            raise DataError(f"{self.path}: not a readable image") from None

    def _upright(self, stored: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A picture turned as the EXIF orientation says."""
        turns, mirrored = _TURNS.get(self._header[2], (0, False))
        image = np.rot90(stored, turns)
        return np.ascontiguousarray(image[:, ::-1] if mirrored else image)

    def _stored(self, flags: int) -> NDArray[np.uint8]:
        """Pixels as they are stored."""
        image = cv2.imread(str(self.path), flags | cv2.IMREAD_IGNORE_ORIENTATION) if self.path.is_file() else None
        if image is None:
            raise DataError(f"{self.path}: not a readable image")
        if image.dtype != np.uint8:  # a grey picture of more than 8 bits; masks hold 255, 65535 or 1 for white
            image = image.astype(np.float64) * (255 / max(float(image.max()), 1.0))
        return np.asarray(image, np.uint8)


@lru_cache(maxsize=4096)
def _digest(path: str, _stored_orientation: bool, _changed: int, _size: int) -> str:
    """Digest of a file's bytes."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_image(path: Path | str) -> NDArray[np.uint8]:
    """Read an image file as (height, width, 3) RGB, upright.

    Raises
    ------
    DataError : missing or unreadable.
    """
    return ImageFile(Path(path)).decode()
