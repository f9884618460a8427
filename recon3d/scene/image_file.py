"""Image files: size and orientation from the header, pixels when they are asked for."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from recon3d.errors import DataError
from recon3d.scene.heic import decode_heic, is_heic, register_heic

_WITH_ALPHA = ("RGBA", "LA", "PA", "RGBa", "La")  # Pillow's modes
_UNREADABLE = frozenset({".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".raw"})
_DARK = 4096  # values of 16 bits below which they are not of 16
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
    white: int | None = None
    """Largest value of a photograph of 16 bits, such as 4095 of a camera of 12 bits; 65535 when None."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path).absolute())

    def __getstate__(self) -> dict[str, object]:
        return {"path": self.path, "stored_orientation": self.stored_orientation, "white": self.white}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright picture; only the header is read."""
        width, height, orientation = self._header[:3]
        return (height, width) if orientation >= 5 else (width, height)

    @property
    def has_alpha(self) -> bool:
        """Whether pixels have an opacity; only the header is read."""
        return self._header[3]

    @property
    def is_deep(self) -> bool:
        """Whether values have 16 bits; only the header is read."""
        return self._header[4]

    @cached_property
    def _header(self) -> tuple[int, int, int, bool, bool]:
        """Width and height as stored, the EXIF orientation to be undone, whether there is an opacity, and 16 bits."""
        if not self.path.is_file():
            raise DataError(f"{self.path}: no such image")
        if is_heic(self.path):
            register_heic(self.path)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                with Image.open(self.path) as image:
                    # A PNG's EXIF is looked for before its pixels only; getexif would decode them.
                    known = image.format != "PNG" or "exif" in image.info
                    orientation = image.getexif().get(_ORIENTATION, 1) if known else 1
                    (width, height), kind = image.size, image.format
                    alpha = image.mode in _WITH_ALPHA or "transparency" in image.info
                    deep = image.mode[0] == "I" or any(";16" in str(part[3]) for part in getattr(image, "tile", ()))
                    space = image.mode
        except Image.DecompressionBombError:
            height, width = self._stored(cv2.IMREAD_GRAYSCALE).shape
            orientation, kind, alpha, deep, space = 1, None, False, False, ""
        except (UnidentifiedImageError, OSError, ValueError, SyntaxError):
            way_out = "; save it as PNG or JPEG" if self.path.suffix.lower() in _UNREADABLE else ""
            raise DataError(f"{self.path}: not a readable image{way_out}") from None
        if space == "LAB":
            raise DataError(f"{self.path}: expected RGB, CMYK or grey, got the colour space LAB; save it as RGB")
        if kind == "TIFF" and orientation in _TURNS:  # OpenCV 5.0 fails on those
            raise DataError(f"{self.path}: a TIFF that is stored turned is not supported; save it upright")
        turned = orientation in _TURNS and not self.stored_orientation
        return width, height, orientation if turned else 1, alpha, deep

    def version(self) -> tuple[str, bool, int | None, int, int]:
        """Key that changes when the file is written again."""
        try:
            found = self.path.stat()
        except OSError as error:
            raise DataError(f"{self.path}: no such image ({error.strerror})") from None
        return str(self.path), self.stored_orientation, self.white, found.st_mtime_ns, found.st_size

    def fingerprint(self) -> str:
        """Text that two files share only where their bytes and their orientation are the same."""
        path, stored, white, *version = self.version()
        return f"{_digest(path, *version)} {stored}{'' if white is None else f' {white}'}"

    def decode(self, *, grey: bool = False) -> NDArray[np.uint8]:
        """Upright picture: (height, width, 3) RGB, or (height, width) grey."""
        width, height = self._header[:2]
        image = self._stored(cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR_RGB)
        if image.dtype != np.uint8:  # masks hold 255, 65535 or 1 for white
            image = image * (255 / max(float(image.max()), 1.0)) if grey else self._of_eight_bits(image)
        if image.shape[:2] != (height, width):
            raise DataError(
                f"{self.path}: the header says {width}x{height} pixels, {image.shape[1]}x{image.shape[0]} were read"
            )
        return self._upright(np.asarray(image, np.uint8))

    def largest(self) -> int:
        """Largest value of any pixel and channel, before it is made one of 8 bits."""
        return int(self._stored(cv2.IMREAD_COLOR_RGB).max())

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

    def _of_eight_bits(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """A picture of 16 bits as one of 8, white being what the set's is."""
        if image.dtype != np.uint16:
            raise DataError(f"{self.path}: expected 8 or 16 bits a channel, got {image.dtype}")
        largest, white = int(image.max()), self.white or 65535
        if largest > white:
            raise DataError(
                f"{self.path}: expected values up to {white}, as of the set's other photographs, got {largest}"
            )
        if self.white is None and 0 < largest < _DARK:
            raise DataError(
                f"{self.path}: its 16 bits hold values up to {largest} only, as of a camera of 12 bits; scale them so "
                "that white is 65535, or save 8 bits"
            )
        return np.asarray(cv2.convertScaleAbs(image, alpha=255 / white), np.uint8)

    def _stored(self, flags: int) -> NDArray[Any]:
        """Pixels as they are stored, a color photograph's in the order RGB."""
        if is_heic(self.path):
            colors = decode_heic(self.path)
            return np.asarray(cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY)) if flags == cv2.IMREAD_GRAYSCALE else colors
        flags |= cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imread(str(self.path), flags) if self.path.is_file() else None
        if image is None:
            raise DataError(f"{self.path}: not a readable image")
        return np.asarray(image)


@lru_cache(maxsize=4096)
def _digest(path: str, _changed: int, _size: int) -> str:
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
