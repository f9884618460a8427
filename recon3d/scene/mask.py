"""Masks of the object: in memory, in a file, or computed when first asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.scene.camera import Camera, scaled_size
from recon3d.scene.image_file import ImageFile
from recon3d.scene.photograph import array_fingerprint
from recon3d.scene.pixel_cache import PIXELS
from recon3d.values import ByContent, Once

_MIDDLE = 127  # grey level


class Mask(ABC):
    """Where in a photograph the object may be."""

    @abstractmethod
    def read(self, camera: Camera) -> NDArray[np.bool_]:
        """(height, width) of the undistorted photograph of a camera, True where the object may be.

        What the photograph itself does not show may be object.
        """

    @property
    @abstractmethod
    def size(self) -> tuple[int, int]:
        """Width and height; reads no pixels."""

    @abstractmethod
    def fingerprint(self) -> str:
        """Text that two masks share only where they are the same."""

    @abstractmethod
    def shrunk(self, scale: float) -> Mask:
        """The mask of the photograph at a scale below 1."""

    @staticmethod
    def of(source: Mask | Path | str | NDArray[np.bool_]) -> Mask:
        """The mask itself, or that of an image file or of an array (height, width)."""
        if isinstance(source, Mask):
            return source
        return ArrayMask(source) if isinstance(source, np.ndarray) else FileMask(ImageFile(Path(source)))


@dataclass(frozen=True, init=False, eq=False)
class ArrayMask(ByContent, Mask):
    """A mask (height, width) in memory."""

    shape: tuple[int, int]
    """Height and width."""
    bits: NDArray[np.uint8] = field(repr=False)
    """(n,) the pixels, packed: eight a byte."""

    def __init__(self, mask: NDArray[np.bool_]) -> None:
        if mask.ndim != 2 or mask.dtype != np.bool_:
            raise ArgumentError(f"expected a bool mask (height, width), got {mask.shape} {mask.dtype}")
        object.__setattr__(self, "shape", mask.shape)
        object.__setattr__(self, "bits", np.packbits(mask))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.shape[1], self.shape[0]

    def shrunk(self, scale: float) -> ArrayMask:
        """The mask of the photograph at a scale; a pixel is object where more than half of what it covers is."""
        values = 255 * self.unpacked().view(np.uint8)
        return ArrayMask(cv2.resize(values, scaled_size(*self.size, scale), interpolation=cv2.INTER_AREA) > _MIDDLE)

    def unpacked(self) -> NDArray[np.bool_]:
        """(height, width), as it was given."""
        return np.unpackbits(self.bits, count=self.shape[0] * self.shape[1]).reshape(self.shape).view(np.bool_)

    def read(self, camera: Camera) -> NDArray[np.bool_]:
        """(height, width) the mask, undistorted."""
        mask = self.unpacked()
        return camera.undistorted(255 * mask.view(np.uint8), beyond=255) > 127 if camera.distortion else mask

    def fingerprint(self) -> str:
        """Digest of the file or array."""
        return f"{self.shape} {array_fingerprint(self.bits)}"


@dataclass(frozen=True)
class FileMask(Mask):
    """A mask in an image file, read upright like photographs: bright for object, or opaque.

    A pixel is object above half of the file's largest value where that is no brighter than a middle grey, as of masks
    that hold 0 and 1, and else above the middle grey.
    """

    file: ImageFile
    """Of the mask."""
    alpha: bool = False
    """Read the file's opacity, not its brightness."""
    of_size: tuple[int, int] | None = None
    """Width and height that it is scaled to, each pixel being the mean of what it covers; its own when None."""
    inverted: bool = False
    """Dark for object."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.of_size or self.file.size

    def shrunk(self, scale: float) -> FileMask:
        """The mask of the photograph at a scale."""
        return replace(self, of_size=scaled_size(*self.size, scale))

    def read(self, camera: Camera) -> NDArray[np.bool_]:
        """(height, width) the pixels brighter than half, undistorted."""
        key = ("mask", self.file.version(), self.alpha, self.inverted, self.size, camera if camera.distortion else None)

        def mask() -> NDArray[np.bool_]:
            values = self.file.decode_alpha() if self.alpha else self.file.decode(grey=True)
            if not self.alpha and 0 < (largest := int(values.max())) <= _MIDDLE:
                values = np.asarray(values > largest / 2, np.uint8) * np.uint8(255)
            values = 255 - values if self.inverted else values
            if self.size != self.file.size:
                larger = self.size[0] > self.file.size[0]
                way = cv2.INTER_LINEAR if larger else cv2.INTER_AREA
                values = np.asarray(cv2.resize(values, self.size, interpolation=way), np.uint8)
            return camera.undistorted(values, beyond=255) > _MIDDLE

        return PIXELS.get(key, mask)

    def fingerprint(self) -> str:
        """Digest of the file, and how it is read."""
        told = f"{self.file.fingerprint()}{' alpha' if self.alpha else ''}{' inverted' if self.inverted else ''}"
        return f"{told}{f' {self.size}' if self.size != self.file.size else ''}"


@dataclass(frozen=True, eq=False)
class ComputedMask(ByContent, Mask):
    """A mask that is made of undistorted photographs when first asked for, and then kept, packed."""

    made: Once[ArrayMask] = field(default_factory=Once, init=False, repr=False, compare=False)
    """The finished mask."""

    @abstractmethod
    def compute(self) -> NDArray[np.bool_]:
        """(height, width) the mask, from pixels."""

    def read(self, camera: Camera) -> NDArray[np.bool_]:
        """(height, width) what is computed, or was before."""
        return self.made.get(lambda: ArrayMask(self.compute() | ~camera.shown())).unpacked()
