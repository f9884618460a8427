"""Photographs, read when they are asked for."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.scene.camera import Camera, scaled_size
from recon3d.scene.image_file import ImageFile
from recon3d.scene.pixel_cache import PIXELS
from recon3d.values import ByContent

_SERIAL = count()


@dataclass(frozen=True, init=False, eq=False)
class Photograph(ByContent):
    """A photograph in a file, of which only the header is read at first, or in memory.

    Pixels are kept by the process's ``PIXELS``, not by the photograph. It is read upright, as its EXIF orientation
    says, and so K, width and height are those of the upright picture.

    Raises
    ------
    DataError : the file is missing or unreadable.
    ArgumentError : an array is no (height, width, 3) uint8 RGB image.
    """

    source: ImageFile | NDArray[np.uint8] = field(repr=False)
    """File, or (height, width, 3) RGB."""
    of_size: tuple[int, int] | None = None
    """Width and height that it is shrunk to, each pixel being the mean of what it covers; the source's when None."""

    def __init__(
        self,
        source: Path | str | ImageFile | NDArray[np.uint8],
        of_size: tuple[int, int] | None = None,
        *,
        stored_orientation: bool = False,
    ) -> None:
        if isinstance(source, (str, Path)):
            source = ImageFile(Path(source), stored_orientation)
        if isinstance(source, np.ndarray):
            if source.dtype != np.uint8 or source.ndim != 3 or source.shape[2] != 3:
                raise ArgumentError(
                    f"expected an (height, width, 3) uint8 RGB image, got {source.shape} {source.dtype}"
                )
            source = source.view()
            source.setflags(write=False)
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "of_size", of_size)
        self._identify()

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._identify()

    def _identify(self) -> None:
        """Number arrays, so that the cache tells them apart."""
        object.__setattr__(self, "_serial", next(_SERIAL))

    @classmethod
    def of(cls, source: Photograph | Path | str | NDArray[np.uint8]) -> Photograph:
        """The photograph itself, or that of a file or of an array (height, width, 3)."""
        return source if isinstance(source, Photograph) else cls(source)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height; reads no pixels."""
        return self.of_size or self._source_size

    @property
    def _source_size(self) -> tuple[int, int]:
        if isinstance(self.source, ImageFile):
            return self.source.size
        return self.source.shape[1], self.source.shape[0]

    def shrunk(self, width: int, height: int) -> Photograph:
        """The same photograph of fewer pixels, each the mean of what it covers."""
        return Photograph(self.source, (width, height))

    def read(self, scale: float = 1.0, *, camera: Camera | None = None) -> NDArray[np.uint8]:
        """(height, width, 3) RGB, read-only; below a scale of one each pixel is the mean of what it covers.

        Parameters
        ----------
        camera : what the lens distorted is undone first; pixels that the photograph does not show continue its border.
        """
        size = scaled_size(*self.size, scale)
        distorted = camera is not None and bool(camera.distortion)
        if isinstance(self.source, np.ndarray) and size == self._source_size and not distorted:
            return self.source
        key = ("photograph", self._version(), self.of_size, camera if distorted else None)

        def whole() -> NDArray[np.uint8]:
            stored = self.source.decode() if isinstance(self.source, ImageFile) else self.source
            if self.size != self._source_size:
                stored = np.asarray(cv2.resize(stored, self.size, interpolation=cv2.INTER_AREA), np.uint8)
            return camera.undistorted(stored) if camera is not None else stored

        def smaller() -> NDArray[np.uint8]:
            pixels = PIXELS.get((*key, self.size), whole, keep=False)
            return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)

        return PIXELS.get((*key, size), whole if size == self.size else smaller)

    def fingerprint(self) -> str:
        """Text that two photographs share only where they are the same, from the file's bytes or the array."""
        of_source = self.source.fingerprint() if isinstance(self.source, ImageFile) else array_fingerprint(self.source)
        return of_source if self.of_size is None else f"{of_source} of {self.of_size}"

    def _version(self) -> object:
        return self.source.version() if isinstance(self.source, ImageFile) else vars(self)["_serial"]


def array_fingerprint(array: NDArray[np.generic]) -> str:
    """Digest of an array's shape and content."""
    return f"{array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
