"""pycolmap, which only calibrating photographs needs."""

from __future__ import annotations

from typing import Any

# Before pycolmap: where it is loaded first, its zlib serves Pillow too, and writing a PNG ends in a crash.
import PIL.Image  # noqa: F401

from recon3d.errors import CalibrationError


def load_pycolmap() -> Any:
    """The module, without its log: what goes wrong is told in words, here.

    Raises
    ------
    CalibrationError : it is not installed.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise CalibrationError(
            f"calibrating photographs needs pycolmap ({error}), which has wheels for x86-64 and macOS: install it, or "
            "calibrate elsewhere and open the COLMAP model"
        ) from None
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL.value)
    return pycolmap
