"""Files written whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_UNFINISHED = ".unfinished-"  # in the names of temporary files


_ABANDONED = 3600.0  # seconds; no file takes so long to be written


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Temporary path beside the target, moved onto it when the block ends well and removed when it does not."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}{_UNFINISHED}", suffix=target.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:  # a full disk names no file
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(target)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path | str) -> Iterator[Path]:
    """Temporary folder beside the target, which is new or empty, moved to it or removed like ``atomic_path``'s file."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}{_UNFINISHED}"))
    try:
        yield temporary
        temporary.chmod(0o777 & ~_umask())
        if target.is_dir():
            target.rmdir()
        temporary.replace(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_leftovers(folder: Path | str) -> None:
    """Remove temporary files and folders that runs which were killed left in a folder: those untouched for an hour."""
    for path in Path(folder).glob(f".*{_UNFINISHED}*"):
        with suppress(OSError):  # another run may be quicker
            if time() - path.stat().st_mtime > _ABANDONED:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _umask() -> int:
    """The process's file mode mask, which mkstemp ignores."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_image(path: Path | str, image: NDArray[np.uint8] | NDArray[np.bool_]) -> Path:
    """Write an RGB image (height, width, 3), or a mask (height, width) as black and white; returns the path."""
    pixels = np.asarray(image, np.uint8) * np.uint8(255 if image.dtype == np.bool_ else 1)
    if pixels.ndim == 3:
        pixels = pixels[..., ::-1]  # OpenCV writes BGR
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), pixels):
            raise OSError(f"{path}: OpenCV could not write the image")
    return Path(path)


def write_json(path: Path | str, content: Mapping[str, Any]) -> Path:
    """Write a JSON record; returns the path."""
    return write_text(path, json.dumps(content, indent=2, allow_nan=False, default=np.generic.item) + "\n")


def write_text(path: Path | str, text: str) -> Path:
    """Write a text file; returns the path."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)
