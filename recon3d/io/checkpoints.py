"""Finished stages of a run, kept in a folder so that an interrupted run can go on."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterable, Iterator, MutableMapping
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from recon3d.io.files import atomic_path

_KEY = "made for"


@cache
def code_fingerprint() -> str:
    """Text that changes with the package's source: what other code has made is made again."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


class Checkpoints(MutableMapping[str, dict[str, NDArray[Any]]]):
    """Named groups of arrays, a file each, written whole or not at all.

    Parameters
    ----------
    folder : made when the first stage is put into it.
    key : text that says what the stages are made from. Stages of another key are as good as absent and are replaced.
    """

    def __init__(self, folder: Path | str, key: str) -> None:
        self.folder, self.key = Path(folder), key

    def __getitem__(self, name: str) -> dict[str, NDArray[Any]]:
        try:
            with self._path(name).open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = dict(stored)
            if str(arrays.pop(_KEY)) == self._made_for(arrays):
                return arrays
        except (OSError, KeyError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile):
            pass  # a file that is missing or was damaged is made again
        raise KeyError(name)

    def __setitem__(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        with atomic_path(self._path(name)) as temporary, temporary.open("wb") as file:
            # numpy would take an array of the name "file" or "allow_pickle" for its own; no stage has one.
            np.savez(file, **{_KEY: np.array(self._made_for(arrays)), **arrays})  # type: ignore[arg-type]

    def __delitem__(self, name: str) -> None:
        if name not in self:
            raise KeyError(name)
        self._path(name).unlink()

    def __iter__(self) -> Iterator[str]:
        names = (unquote(path.stem) for path in sorted(self.folder.glob("*.npz")))
        return (name for name in names if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _made_for(self, arrays: Iterable[str]) -> str:
        """What a file says of itself: the key, and its arrays, since a damaged directory may not tell all of them."""
        return f"{self.key}: {', '.join(sorted(arrays))}"

    def _path(self, name: str) -> Path:
        """File of a stage, whose name may hold any character."""
        return self.folder / f"{quote(name, safe=' ')}.npz"
