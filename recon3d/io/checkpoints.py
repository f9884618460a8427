"""Finished results in a folder, so that an interrupted run resumes."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.files import atomic_path, remove_leftovers
from recon3d.tasks import Arrays

_KEY = "made for"


class Checkpoints:
    """Named groups of arrays in a folder, a file each, written whole or not at all.

    Each group has a key, which tells what it was made from (``recon3d.tasks.content_key``). A group with another key,
    or in a damaged file, counts as missing and is overwritten.

    Parameters
    ----------
    folder : made when the first group is written. Temporary files of runs that were killed are removed from it.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        remove_leftovers(self.folder)

    def read(self, name: str, key: str) -> dict[str, NDArray[Any]] | None:
        """Arrays of a name that were written with that key; None where there are none.

        Raises
        ------
        DataError : a folder lies where they are kept, so that nothing could be written there either.
        """
        path = self._path(name)
        if path.is_dir():
            raise DataError(f"{path}: expected a file of a finished stage, or none, got a folder; move it away")
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                if str(stored[_KEY]) != _told(key, (each for each in stored if each != _KEY)):
                    return None
                return {each: stored[each] for each in stored if each != _KEY}
        except (OSError, KeyError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile):
            return None

    def write(self, name: str, key: str, arrays: Arrays) -> None:
        """Keep arrays under a name, instead of what was there."""
        with atomic_path(self._path(name)) as temporary, temporary.open("wb") as file:
            # numpy would take an array of the name "file" or "allow_pickle" for its own; no group has one.
            np.savez(file, **{_KEY: np.array(_told(key, arrays)), **arrays})  # type: ignore[arg-type]

    def names(self) -> list[str]:
        """Names of all that was written, in order, whatever its key."""
        return sorted(unquote(path.stem) for path in self.folder.glob("[!.]*.npz"))

    def _path(self, name: str) -> Path:
        """File of a group, whose name may hold any character."""
        return self.folder / f"{quote(name, safe=' ')}.npz"


def _told(key: str, names: Iterable[str]) -> str:
    """What a file says of itself: the key, and its arrays, since a damaged directory may not tell all of them."""
    return f"{key}: {', '.join(sorted(names))}"
