"""A picture on a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class Texture:
    """Colours of a mesh's triangles, in an image.

    Raises
    ------
    ArgumentError : places or image have another shape.
    """

    places: NDArray[np.float64]
    """(n_triangles, 3, 2) of the triangles' corners in the image, in [0, 1]: to the right, downwards."""
    image: NDArray[np.uint8]
    """(rows, columns, 3) RGB."""

    def __post_init__(self) -> None:
        if self.places.ndim != 3 or self.places.shape[1:] != (3, 2):
            raise ArgumentError(f"expected places (n_triangles, 3, 2), got {self.places.shape}")
        if self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.dtype != np.uint8:
            raise ArgumentError(
                f"expected an (rows, columns, 3) uint8 image, got {self.image.shape} {self.image.dtype}"
            )

    def colors(self, triangles: NDArray[np.integer], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) colours in [0, 1] at places in triangles (n,), by weights (n, 3) of their corners; bilinear."""
        size = np.array([self.image.shape[1], self.image.shape[0]])
        texels = (np.einsum("nc,ncd->nd", weights, self.places[triangles]) * size - 0.5).astype(np.float32)
        found = np.empty((len(texels), 3))
        for first in range(0, len(texels), _MOST):
            part = np.ascontiguousarray(texels[first : first + _MOST, None])
            shown = cv2.remap(self.image, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            found[first : first + _MOST] = shown.reshape(-1, 3) / 255.0
        return found


_MOST = 32_000  # places at a time that OpenCV looks up
