"""Decoded pictures, kept by the process up to a limit in bytes: scenes name their pictures, this holds the pixels."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any

import psutil
from numpy.typing import NDArray

from recon3d.errors import ArgumentError

_SHARE, _MOST = 8, 4 * 2**30  # part of the machine's memory, and bytes


class PixelCache:
    """Read-only arrays by key, those least recently asked for dropped first; safe to use from several threads."""

    def __init__(self, limit: int | None = None) -> None:
        self._arrays: OrderedDict[Hashable, NDArray[Any]] = OrderedDict()
        self._lock = Lock()
        self._held = 0
        self._limit = min(psutil.virtual_memory().total // _SHARE, _MOST) if limit is None else limit

    @property
    def held(self) -> int:
        """Bytes of all arrays that are kept."""
        return self._held

    @property
    def limit(self) -> int:
        """Most bytes that are kept; by default an eighth of the machine's memory, at most 4 GiB. May be set."""
        return self._limit

    @limit.setter
    def limit(self, limit: int) -> None:
        if limit < 0:
            raise ArgumentError(f"expected a limit of 0 bytes or more, got {limit}")
        with self._lock:
            self._limit = limit
            self._drop()

    def get(self, key: Hashable, make: Callable[[], NDArray[Any]], *, keep: bool = True) -> NDArray[Any]:
        """The array, of any shape, of a key, made where it is not kept, and then kept for the next one to ask."""
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
                return self._arrays[key]
        array = make()
        array.setflags(write=False)
        with self._lock:
            if keep and key not in self._arrays and array.nbytes <= self._limit:
                self._arrays[key] = array
                self._held += array.nbytes
                self._drop()
        return array

    def _drop(self) -> None:
        while self._held > self._limit:
            self._held -= self._arrays.popitem(last=False)[1].nbytes


PIXELS = PixelCache()
"""The process's one cache."""
