"""A background of one color: which color, and what differs from it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from os import cpu_count

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.scene.bounds import Bounds
from recon3d.scene.regions import bounds_mask
from recon3d.scene.view import View
from recon3d.values import ByContent, Once

BACKGROUND_LEVEL = 0.19
"""Fraction of white below which a pixel is dark background (the Middlebury dinoSparseRing recipe)."""

BLACK = (0, 0, 0)

_FRAME = 0.02  # of the shorter side: width of an image's frame
_PLAIN = 8  # grey levels between half of the frame and its median color: more than noise and soft light make


def foreground(
    image: NDArray[np.uint8], level: float = BACKGROUND_LEVEL, color: tuple[int, int, int] = BLACK
) -> NDArray[np.bool_]:
    """(height, width) pixels of an RGB image that differ from a background's color by more than a fraction of white."""
    return difference(image, color) > level * 255


def difference(image: NDArray[np.uint8], color: tuple[int, int, int] = BLACK) -> NDArray[np.uint8]:
    """(height, width) largest difference of an RGB image's channels from a color; from black, the brightest channel."""
    red, green, blue = cv2.split(image if color == BLACK else cv2.absdiff(image, np.array(color, np.float64)))
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def has_plain_frame(image: NDArray[np.uint8]) -> bool:
    """Whether the frame of an RGB image (height, width, 3) is of about one color, as before a backdrop."""
    frame = _frame(image)
    return bool(np.median(np.abs(frame - np.median(frame, axis=0)).max(axis=1)) <= _PLAIN)


def frame_color(image: NDArray[np.uint8]) -> tuple[int, int, int]:
    """Median color, RGB, of the frame of an image (height, width, 3)."""
    red, green, blue = (int(value) for value in np.median(_frame(image), axis=0))
    return red, green, blue


def _frame(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(n, 3) pixels of an RGB image's frame."""
    width = max(1, round(_FRAME * min(image.shape[:2])))
    inner = np.zeros(image.shape[:2], np.bool_)
    inner[width:-width, width:-width] = True
    return image[~inner].astype(np.int64)


def background_color(views: Iterable[View], bounds: Bounds) -> tuple[int, int, int]:
    """Median color, RGB, of what views show outside the projected bounds; black where it is dark, or all are full."""
    return _median_color(np.sum([_histograms(view, bounds)[1:] for view in views], axis=0))


def _histograms(view: View, bounds: Bounds) -> NDArray[np.int64]:
    """(4, 256) numbers of pixels outside the projected bounds, by their brightest channel, and by red, green, blue."""
    image, outside = view.image, np.asarray(~bounds_mask(bounds, view), np.uint8)
    pictures = (difference(image), *cv2.split(image))
    return np.array([cv2.calcHist([each], [0], outside, [256], [0, 256]).ravel() for each in pictures]).astype(np.int64)


def _median_color(counts: NDArray[np.int64]) -> tuple[int, int, int]:
    """Color of (3, 256) numbers of pixels by channel."""
    n = int(counts[0].sum())
    red, green, blue = (int(np.searchsorted(channel.cumsum(), n / 2)) for channel in counts)
    return (red, green, blue) if n and max(red, green, blue) > BACKGROUND_LEVEL * 255 else BLACK


@dataclass(frozen=True, eq=False)
class Background(ByContent):
    """What the views show outside the projected bounds."""

    views: tuple[View, ...]
    bounds: Bounds
    _found: Once[tuple[tuple[int, int, int], float]] = field(
        default_factory=Once, init=False, repr=False, compare=False
    )
    _shrunk: dict[float, Once[Background]] = field(default_factory=dict, init=False, repr=False, compare=False)
    _fingerprint: Once[str] = field(default_factory=Once, init=False, repr=False, compare=False)

    def __hash__(self) -> int:
        return hash((len(self.views), self.bounds))  # every view's mask asks for it

    @property
    def color(self) -> tuple[int, int, int]:
        """Its color, RGB."""
        return self._found.get(self._find)[0]

    @property
    def level(self) -> float:
        """Fraction of white that 99% of its pixels do not differ by from the color."""
        return self._found.get(self._find)[1]

    def _find(self) -> tuple[tuple[int, int, int], float]:
        with ThreadPoolExecutor(cpu_count()) as pool:  # OpenCV and numpy release the interpreter lock
            by_channel = np.sum(list(pool.map(lambda view: _histograms(view, self.bounds), self.views)), axis=0)
            color, counts = _median_color(by_channel[1:]), by_channel[0]
            if color != BLACK:
                counts = np.sum(list(pool.map(lambda view: self._histogram(view, color), self.views)), axis=0)
        n = int(counts.sum())
        if n == 0:
            return color, BACKGROUND_LEVEL
        # Linear between the two pixels, in order of brightness, that the percentile lies between.
        place = 0.99 * (n - 1)
        below, above = np.searchsorted(counts.cumsum(), [np.floor(place), np.ceil(place)], side="right")
        return color, float(below + (above - below) * (place % 1)) / 255

    def _histogram(self, view: View, color: tuple[int, int, int]) -> NDArray[np.int64]:
        """(256,) number of background pixels of each difference from a color."""
        return np.bincount(difference(view.image, color)[~bounds_mask(self.bounds, view)], minlength=256)

    def shrunk(self, scale: float) -> Background:
        """That of the views at a scale; one for all views' masks."""
        made = self._shrunk.setdefault(scale, Once())
        return made.get(lambda: Background(tuple(view.shrunk(scale) for view in self.views), self.bounds))

    def fingerprint(self) -> str:
        """Text that tells the bounds and all photographs."""

        def digest() -> str:
            told = repr((self.bounds, [view.fingerprint() for view in self.views]))
            return hashlib.sha256(told.encode()).hexdigest()

        return self._fingerprint.get(digest)
