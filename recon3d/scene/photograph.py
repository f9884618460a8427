"""Photographs, read when they are asked for."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError


def read_image(path: Path | str) -> NDArray[np.uint8]:
    """Read an image as (height, width, 3) RGB.

    Raises
    ------
    DataError : missing or unreadable.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: no such image")
    image = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise DataError(f"{path}: not a readable image")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)
